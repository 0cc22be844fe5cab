"""Reference models of meshes. Each is made once in a test run, by the first process that needs it."""

from __future__ import annotations

import fcntl
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from huepose.geometry import Mesh
from huepose.model.io import load_model, model_path, save_model
from huepose.model.types import ReferenceModel
from huepose.onboarding.onboard import onboard_mesh

shelf: Path | None = None
"""A folder that all processes of a test run share, and the three runs of `make test`; None outside a run."""


def onboarded(mesh: Mesh, name: str, **how: Any) -> ReferenceModel:
    """The result of `onboard_mesh`, bit by bit."""
    if shelf is None:
        return onboard_mesh(mesh, name, **how)
    digest = hashlib.sha256(repr(sorted(how.items())).encode())
    digest.update(mesh.content())
    path = model_path(shelf / digest.hexdigest()[:16], name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            save_model(onboard_mesh(mesh, name, **how), path)
    made = load_model(path)
    # As after onboarding: no digest, so nothing derived from the model is cached.
    return replace(made, digest=None, mesh=replace(made.mesh, digest=None))


def times_as_large(model: ReferenceModel, times: float) -> ReferenceModel:
    """The model scaled by `times`, without changing its views and keypoints."""
    surface, factor = model.surface, np.float32(times)
    mesh = Mesh(model.mesh.vertices * factor, model.mesh.faces, model.mesh.uv, model.mesh.texture)
    scaled = replace(surface, points=surface.points * factor)
    return replace(model, mesh=mesh, surface=scaled, diameter_m=model.diameter_m * times, digest=None)
