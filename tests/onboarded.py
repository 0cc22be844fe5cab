"""Reference models of meshes. Each is made once in a test run, by the first process that needs it."""

from __future__ import annotations

import fcntl
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from huepose.geometry import Mesh
from huepose.model.io import load_model, model_path, save_model
from huepose.model.types import ReferenceModel
from huepose.onboarding import reference
from huepose.onboarding.onboard import onboard_mesh
from huepose.propose import keypoint_reference
from huepose.propose.templates import build_templates

shelf: Path | None = None
"""A folder that all processes of a test run share, and the three runs of `make test`; None outside a run."""


@contextmanager
def few_views() -> Iterator[None]:
    """A context in which models get templates and keypoints from twelve sides only: they take most of an
    onboarding, and are used only to search for the object."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(keypoint_reference, "LEVEL", 0)
        patch.setattr(reference, "build_templates", partial(build_templates, level=0))
        yield


def onboarded(mesh: Mesh, name: str, *, searched: bool = True, **how: Any) -> ReferenceModel:
    """The result of `onboard_mesh`, bit by bit; with `few_views` if it is not searched for."""
    if shelf is None:
        return _made(mesh, name, searched, how)
    digest = hashlib.sha256(repr((searched, *sorted(how.items()))).encode())
    digest.update(mesh.content())
    path = model_path(shelf / digest.hexdigest()[:16], name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            save_model(_made(mesh, name, searched, how), path)
    made = load_model(path)
    # As after onboarding: no digest, so nothing derived from the model is cached.
    return replace(made, digest=None, mesh=replace(made.mesh, digest=None))


def _made(mesh: Mesh, name: str, searched: bool, how: dict[str, Any]) -> ReferenceModel:
    with nullcontext() if searched else few_views():
        return onboard_mesh(mesh, name, **how)


def times_as_large(model: ReferenceModel, times: float) -> ReferenceModel:
    """The model scaled by `times`, without changing its views and keypoints."""
    surface, factor = model.surface, np.float32(times)
    mesh = Mesh(model.mesh.vertices * factor, model.mesh.faces, model.mesh.uv, model.mesh.texture)
    scaled = replace(surface, points=surface.points * factor)
    return replace(model, mesh=mesh, surface=scaled, diameter_m=model.diameter_m * times, digest=None)
