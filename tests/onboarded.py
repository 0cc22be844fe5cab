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
def few_views(templates: bool = True) -> Iterator[None]:
    """A context in which models get keypoints and templates from twelve sides only, or keypoints alone: they
    take most of an onboarding, and are used only to search for the object. Each side's keypoints are compared
    with one other view instead of three."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(keypoint_reference, "LEVEL", 0)
        patch.setattr(keypoint_reference, "TEST_VIEWS", 1)
        if templates:
            patch.setattr(reference, "build_templates", partial(build_templates, level=0))
        yield


def onboarded(
    mesh: Mesh, name: str, *, searched: bool = True, plain: bool = False, **how: Any
) -> ReferenceModel:
    """The result of `onboard_mesh`, bit by bit; with `few_views` if it is not searched for, with those of
    keypoints if it is plain: it is searched for by its shape."""
    if shelf is None:
        return _made(mesh, name, searched, plain, how)
    digest = hashlib.sha256(repr((searched, plain, *sorted(how.items()))).encode())
    digest.update(mesh.content())
    path = model_path(shelf / digest.hexdigest()[:16], name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            save_model(_made(mesh, name, searched, plain, how), path)
    made = load_model(path)
    # As after onboarding: no digest, so nothing derived from the model is cached.
    return replace(made, digest=None, mesh=replace(made.mesh, digest=None))


def _made(mesh: Mesh, name: str, searched: bool, plain: bool, how: dict[str, Any]) -> ReferenceModel:
    with nullcontext() if searched and not plain else few_views(templates=not searched):
        return onboard_mesh(mesh, name, **how)


def times_as_large(model: ReferenceModel, times: float) -> ReferenceModel:
    """The model scaled by `times`, without changing its views and keypoints."""
    surface, factor = model.surface, np.float32(times)
    mesh = Mesh(model.mesh.vertices * factor, model.mesh.faces, model.mesh.uv, model.mesh.texture)
    scaled = replace(surface, points=surface.points * factor)
    return replace(model, mesh=mesh, surface=scaled, diameter_m=model.diameter_m * times, digest=None)
