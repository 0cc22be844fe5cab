"""A Fast-YCB sequence as a camera. Its labels need the object's frame offset, kept in its reference model."""

from __future__ import annotations

from pathlib import Path

from huepose.datasets.fast_ycb import FastYcbSequence, object_of
from huepose.datasets.types import Scene
from huepose.geometry.arrays import Float64
from huepose.model import load_models
from huepose_services.runtime.config import Config


def open_source(config: Config) -> Scene:
    """The sequence in the folder `camera.path`."""
    assert config.camera.path is not None  # the configuration was checked
    path = Path(config.camera.path)
    offset: Float64 | None = None
    if config.camera.truth and config.bundles is not None:
        name = object_of(path)
        offset = load_models(config.bundles, [name])[name].frame_offset_m
    return FastYcbSequence(path, offset)
