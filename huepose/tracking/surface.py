"""What the tracker keeps of a reference model: surface samples with their colours at three scales.

The samples are in random order and the lists of visible samples are increasing, so the first n of a list are
an even, sparser cover of what is seen: cheap scores read few, refinement reads more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from huepose.geometry.arrays import Float, Float32, Float64, Int32
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.model.types import ReferenceModel

SCALES_M = (0.001, 0.0035, 0.008)
"""Gaussian sigmas of the texture's averages: the first two come with the model, the third is made here."""


class SurfaceArrays(NamedTuple):
    """What compiled loops read. points, normals (N, 3) float32, object frame; lab (3, N, 3) float32 at
    SCALES_M; directions (V, 3), visible, offsets as in model.types.Surface; centre (3,) of the samples'
    bounds; radius: largest distance of a sample from it, metres."""

    points: Float32
    normals: Float32
    lab: Float32
    directions: Float32
    visible: Int32
    offsets: Int32
    centre: Float64
    radius: float


@dataclass(frozen=True, eq=False)
class TrackedSurface:
    """The surface of one object, prepared; diameter_m of the model; thickness_m along its thinnest axis."""

    arrays: SurfaceArrays
    diameter_m: float
    thickness_m: float

    @property
    def radius_m(self) -> float:
        """Of the sphere about the centre that holds the object."""
        return self.arrays.radius

    @staticmethod
    def of(model: ReferenceModel) -> TrackedSurface:
        """Prepare a reference model for tracking (some 10 ms)."""
        s = model.surface
        centre = np.asarray((s.points.max(0) + s.points.min(0)) / 2.0, np.float64)
        coarse = _averaged(s.points, s.normals, s.lab[1], SCALES_M[1], SCALES_M[2])
        return TrackedSurface(
            SurfaceArrays(
                np.ascontiguousarray(s.points, np.float32),
                np.ascontiguousarray(s.normals, np.float32),
                np.ascontiguousarray(np.concatenate([s.lab[:2], coarse[None]]), np.float32),
                np.ascontiguousarray(s.directions, np.float32),
                np.ascontiguousarray(s.visible, np.int32),
                np.ascontiguousarray(s.offsets, np.int32),
                centre,
                float(np.linalg.norm(s.points - centre, axis=1).max()),
            ),
            float(model.diameter_m),
            _thickness(s.points),
        )

    def centre_cam(self, T_cam_obj: Float) -> Float64:
        """The object's centre (3,) in camera axes."""
        return np.asarray(T_cam_obj[:3, :3] @ self.arrays.centre + T_cam_obj[:3, 3], np.float64)

    def box(self, T_cam_obj: Float, camera: Camera) -> Box | None:
        """Bounds of the object in the image, from every fourth sample; None when it reaches behind the
        camera. Not clipped to the image."""
        p = self.arrays.points[::4] @ np.asarray(T_cam_obj[:3, :3], np.float32).T
        p += np.asarray(T_cam_obj[:3, 3], np.float32)
        if float(p[:, 2].min()) < 0.02:
            return None
        u, v = p[:, 0] / p[:, 2] * camera.fx + camera.cx, p[:, 1] / p[:, 2] * camera.fy + camera.cy
        x, y = float(u.min()), float(v.min())
        return Box(x, y, float(u.max()) - x, float(v.max()) - y)


def _thickness(points: Float32) -> float:
    """Extent of the points along the axis in which they spread least, metres."""
    q = points - points.mean(0)
    along = q @ np.linalg.eigh((q.T @ q).astype(np.float64))[1][:, 0]
    return float(np.ptp(along))


def _averaged(points: Float32, normals: Float32, lab: Float32, have_m: float, want_m: float) -> Float32:
    """Colours (N, 3) averaged further over neighbours that face the same way, from one sigma to a larger
    one."""
    sigma = float(np.sqrt(want_m**2 - have_m**2))
    pairs = cKDTree(points).query_pairs(2.5 * sigma, output_type="ndarray")
    own = np.arange(len(points))
    i, j = np.concatenate([pairs[:, 0], pairs[:, 1], own]), np.concatenate([pairs[:, 1], pairs[:, 0], own])
    d2 = ((points[i] - points[j]) ** 2).sum(1)
    w = np.exp(-d2 / (2 * sigma**2)) * np.maximum((normals[i] * normals[j]).sum(1), 0.0)
    total = np.bincount(i, w, len(points))
    return np.stack([np.bincount(i, w * lab[j, c], len(points)) / total for c in range(3)], 1).astype(
        np.float32
    )
