"""Boxes for estimation: ground-truth boxes, and ground-truth boxes disturbed like those of a detector.

The paper moves ground-truth boxes by up to a tenth of their size (section IV); here they are scaled, too.
"""

from __future__ import annotations

import zlib
from typing import Literal

import numpy as np

from huepose.datasets.types import GroundTruth
from huepose.geometry.arrays import Float
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh

Disturbance = Literal["perturbed", "paper", "gt"]


def projected_box(mesh: Mesh, T_cam_obj: Float, camera: Camera) -> Box | None:
    """Bounds in pixels of the mesh's vertices at a pose, not clipped to the image; None if no vertex is in
    front of the camera."""
    R, t = T_cam_obj[:3, :3], T_cam_obj[:3, 3]
    pixels = camera.project(mesh.vertices.astype(np.float64) @ R.T + t)
    pixels = pixels[np.isfinite(pixels).all(1)]
    return Box.of_pixels(pixels) if len(pixels) else None


def truth_box(truth: GroundTruth, mesh: Mesh, camera: Camera) -> Box | None:
    """The ground-truth box: that of the data set, else the bounds of the visible mask, else of the projected
    mesh.

    None if the object is not in the image by any of these."""
    if truth.box_visib is not None:
        return truth.box_visib
    mask = truth.mask()
    box = Box.of_mask(mask) if mask is not None else None
    if box is None and truth.T_cam_obj is not None:
        box = projected_box(mesh, truth.T_cam_obj, camera)
        box = box.clipped(camera.width, camera.height) if box is not None else None
    return None if box is None or box.area == 0 else box


def disturbed(
    box: Box, kind: Disturbance, seed: int, scene: str, image: int, instance: int, camera: Camera
) -> Box:
    """The disturbed box of one label. It depends only on the arguments, not on what else is evaluated.

    `perturbed`: moved by U(-0.1, 0.1) of its width and height, then both sides scaled by one U(0.9, 1.1)
    about the centre; `paper`: moved only; both are clipped to the image. `gt`: not changed."""
    if kind == "gt":
        return box
    rng = np.random.default_rng([seed, zlib.crc32(scene.encode()), image, instance])
    dx, dy = rng.uniform(-0.1, 0.1) * box.w, rng.uniform(-0.1, 0.1) * box.h
    scale = rng.uniform(0.9, 1.1) if kind == "perturbed" else 1.0
    w, h = box.w * scale, box.h * scale
    x, y = box.x + dx + (box.w - w) / 2.0, box.y + dy + (box.h - h) / 2.0
    return Box(x, y, w, h).clipped(camera.width, camera.height)
