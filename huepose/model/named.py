"""One of the known models, or an error that lists them."""

from __future__ import annotations

from collections.abc import Mapping

from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError


def model_named(models: Mapping[str, ReferenceModel], name: str) -> ReferenceModel:
    """The model of that name. Raises InputError for an unknown one."""
    if name not in models:
        raise InputError(
            f"object '{name}'",
            found="no reference model of that name",
            expected=f"one of {', '.join(sorted(models)) or 'no objects at all'}",
            fix="Onboard it with `huepose onboard`, or check the spelling.",
        )
    return models[name]
