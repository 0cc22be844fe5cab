"""The reference model of an object: its types and its file."""

from huepose.model.io import load_model, load_models, save_model
from huepose.model.types import ReferenceModel

__all__ = ["ReferenceModel", "load_model", "load_models", "save_model"]
