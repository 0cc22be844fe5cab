"""One surface, one pose: tracked objects compete for the depth pixels of a frame.

Two instances of one object that slid onto the same one, or an object that took its neighbour's surface,
explain the same readings. The pose that explains them worse loses its claim to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.geometry.camera import Camera
from huepose.judge.open_region import PreparedSurface, tolerance_m
from huepose.select.distinct import standing

CELL_PX = 6
"""Claims are compared in cells of this size: about the spacing of the samples on a near object."""

CLAIM_SAMPLES = 200
"""Most surface samples by which a pose claims cells."""


@dataclass(frozen=True, eq=False)
class Claim:
    """A pose and how well it explains its readings."""

    surface: PreparedSurface
    T_cam_obj: Float64
    total: float


def losers(claims: Sequence[Claim], depth: Float32, camera: Camera) -> list[int]:
    """Indices of the claims that others hold with better right; earlier ones win ties."""
    touched = _touched(claims, camera)
    surfaces = [
        _cells(claim, depth, camera) if touches else np.zeros(0, np.int64)
        for claim, touches in zip(claims, touched, strict=True)
    ]
    stand = standing(surfaces, [claim.total for claim in claims])
    return sorted(set(range(len(surfaces))) - set(stand))


def _touched(claims: Sequence[Claim], camera: Camera) -> Bool:
    """Which of the poses can share a cell with another (K,): the cones from the camera round their spheres
    overlap, or nearly."""
    out = np.zeros(len(claims), bool)
    if len(claims) < 2:
        return out
    centres = np.array([claim.surface.centre_cam(claim.T_cam_obj) for claim in claims])
    away = np.maximum(np.linalg.norm(centres, axis=1), 1e-9)
    radii = np.array([claim.surface.radius_m for claim in claims])
    # Two pixels of one cell are a diagonal of it apart; from within a sphere it is everywhere.
    halves = np.where(radii < away, np.arcsin(np.minimum(radii / away, 1.0)), np.pi)
    widths = halves + CELL_PX / min(camera.fx, camera.fy)
    rays = centres / away[:, None]
    apart = np.arccos(np.clip(rays @ rays.T, -1.0, 1.0))
    near = apart <= widths[:, None] + widths
    np.fill_diagonal(near, False)
    return np.asarray(near.any(axis=1))


def _cells(claim: Claim, depth: Float32, camera: Camera) -> Int64:
    """Sorted numbers of the image cells in which depth agrees with the object's surface."""
    surface, T = claim.surface, claim.T_cam_obj
    a = surface.arrays
    p = a.points[surface.shown(T, CLAIM_SAMPLES)] @ T[:3, :3].T + T[:3, 3]
    z = p[:, 2]
    ahead = z > 0.02
    u = np.where(ahead, p[:, 0] / np.where(ahead, z, 1.0) * camera.fx + camera.cx, -1.0)
    v = np.where(ahead, p[:, 1] / np.where(ahead, z, 1.0) * camera.fy + camera.cy, -1.0)
    columns, rows = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
    inside = (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
    columns, rows, z = columns[inside], rows[inside], z[inside]
    tau = 2.0 * tolerance_m(surface.diameter_m, float(surface.centre_cam(T)[2]))
    agrees = np.abs(depth[rows, columns] - z) < tau
    in_a_row = camera.width // CELL_PX + 1
    return np.unique(rows[agrees] // CELL_PX * in_a_row + columns[agrees] // CELL_PX)
