"""Rendered views of single objects for the studies: picture, depth, mask and the true pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render

DISTANCE = 4.0
"""Of the camera, in diameters: larger pictures are those of a longer lens, so that the view is the same."""

BEHIND = 120
"""Grey of what is behind the object."""


@dataclass(frozen=True, eq=False)
class StudyView:
    """frame: what the camera sees; mask (H, W): the object; T_cam_obj: where it is."""

    model: ReferenceModel
    frame: RgbdFrame
    mask: Bool
    T_cam_obj: Float64


def object_view(model: ReferenceModel, direction: Float64, roll_rad: float, pixels: float) -> StudyView:
    """The object seen from `direction` (3,), turned about the optical axis, its diameter `pixels` long."""
    side = int(np.ceil(1.1 * pixels)) + 16
    focal = DISTANCE * pixels
    camera = Camera(focal, focal, (side - 1) / 2, (side - 1) / 2, side, side)
    turn = se3.rotation_exp(np.array([0.0, 0.0, roll_rad])) @ icosphere.look_at(direction)
    place = np.array([0.0, 0.0, DISTANCE * model.diameter_m])
    T = se3.make(turn, place - turn @ model.mesh.centre)
    seen = render([(model.mesh, T)], camera)
    mask = seen.depth > 0
    color = np.where(mask[..., None], seen.color, BEHIND).astype(np.uint8)
    return StudyView(model, RgbdFrame(color, seen.depth, camera), mask, T)


def object_views(
    models: Mapping[str, ReferenceModel], count: int, pixels: float, seed: int = 0
) -> list[StudyView]:
    """`count` views of each object, from directions and at rolls drawn by `seed`."""
    rng = np.random.default_rng(seed)
    views = []
    for model in models.values():
        for _ in range(count):
            direction = rng.normal(size=3)
            roll = rng.uniform(-np.pi, np.pi)
            views.append(object_view(model, direction / np.linalg.norm(direction), roll, pixels))
    return views
