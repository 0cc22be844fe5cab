"""One surface, one pose: tracked objects compete for the depth pixels of a frame.

Two instances of one object that converged to the same copy, or an object on its neighbour's surface, explain
the same readings. The pose that explains them worse loses its claim to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import NEAR_M, Camera, depth_noise_m
from huepose.judge.kernel_arrays import ModelArrays, projected
from huepose.judge.open_region import PreparedSurface, tolerance_m
from huepose.select.distinct import standing
from huepose.support.jit import jit_dividing

CELL_PX = 6
"""Claims are compared in image cells of this size."""

FOOTPRINT = 1.5
"""Side of the square that a sample claims, in mean distances of samples: so the claims of evenly spread
samples leave no gap. A gap in the claim of one object would look like a place that only another object
explains."""

MARGIN_SIGMAS = 2.0
"""An object that lies flat on another one fits the readings there better, by its thickness. A difference of
less than this many standard errors of a reading does not count."""

GRAZING = 0.2
"""Cosine of the angle between line of sight and normal below which a sample claims nothing: its tangent plane
does not tell the depth of the surface beside it."""


@dataclass(frozen=True, eq=False)
class Claim:
    """A pose and how well it explains its readings."""

    surface: PreparedSurface
    T_cam_obj: Float64
    total: float


def losers(claims: Sequence[Claim], depth: Float32, camera: Camera) -> list[int]:
    """Indices of the claims that lose their surface to better ones; earlier claims win ties."""
    touched = _touched(claims, camera)
    if not touched.any():
        return []
    shape = camera.height // CELL_PX + 1, camera.width // CELL_PX + 1
    grids = np.full((len(claims), shape[0] * shape[1]), np.inf, np.float32)
    away_m = 0.0
    for grid, claim, touches in zip(grids, claims, touched, strict=True):
        if touches:
            _fill(claim, depth, camera, grid.reshape(shape))
            away_m = max(away_m, float(claim.surface.centre_cam(claim.T_cam_obj)[2]))
    surfaces = [np.flatnonzero(np.isfinite(grid)) for grid in grids]
    misfits = [grid[surface] for grid, surface in zip(grids, surfaces, strict=True)]
    margin_m = MARGIN_SIGMAS * depth_noise_m(away_m)
    stand = standing(surfaces, [claim.total for claim in claims], misfits, margin_m)
    return sorted(set(range(len(claims))) - set(stand))


def _touched(claims: Sequence[Claim], camera: Camera) -> Bool:
    """Which of the poses (K,) can share a cell with another one: the cones from the camera around their
    spheres overlap, or nearly."""
    out = np.zeros(len(claims), bool)
    if len(claims) < 2:
        return out
    centres = np.array([claim.surface.centre_cam(claim.T_cam_obj) for claim in claims])
    away = np.maximum(np.linalg.norm(centres, axis=1), 1e-9)
    radii = np.array([claim.surface.radius_m for claim in claims])
    # Two pixels of one cell are up to a diagonal apart. A sphere around the camera is everywhere.
    halves = np.where(radii < away, np.arcsin(np.minimum(radii / away, 1.0)), np.pi)
    widths = halves + CELL_PX / min(camera.fx, camera.fy)
    rays = centres / away[:, None]
    apart = np.arccos(np.clip(rays @ rays.T, -1.0, 1.0))
    near = apart <= widths[:, None] + widths
    np.fill_diagonal(near, False)
    return np.asarray(near.any(axis=1))


def _fill(claim: Claim, depth: Float32, camera: Camera, misfit: Float32) -> None:
    """Write into each cell (rows, columns) of the image in which depth and the object's surface agree how
    many metres they differ at least."""
    surface, T = claim.surface, np.array(claim.T_cam_obj, np.float64, order="C")
    box = surface.box(T, camera)
    if box is None:
        return
    view = surface.view_of(T)
    first, last = (int(x) for x in surface.arrays.offsets[view : view + 2])
    spacing_px = np.sqrt(box.w * box.h / max(last - first, 1))
    side = max(1, round(FOOTPRINT * float(spacing_px) / CELL_PX))
    tolerance = 2.0 * tolerance_m(surface.diameter_m, float(surface.centre_cam(T)[2]))
    _claim_cells(T, surface.arrays, first, last, side, depth, camera.lens, tolerance, misfit)


@jit_dividing
def _claim_cells(
    T: Float64,
    surface: ModelArrays,
    first: int,
    last: int,
    side: int,
    depth: Float32,
    lens: Float64,
    tolerance_m: float,
    misfit: Float32,
) -> None:
    """Samples `first` to `last` of a view's visible samples. Each claims those of the `side` x `side` cells
    around it in which the depth of its tangent plane is that of the reading."""
    for k in range(first, last):
        i = surface.visible[k]
        u, v, z = projected(T, surface.points, i, lens)
        if z < NEAR_M:
            continue
        x, y = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
        a, b, c = surface.normals[i, 0], surface.normals[i, 1], surface.normals[i, 2]
        n0 = T[0, 0] * a + T[0, 1] * b + T[0, 2] * c
        n1 = T[1, 0] * a + T[1, 1] * b + T[1, 2] * c
        n2 = T[2, 0] * a + T[2, 1] * b + T[2, 2] * c
        along = n0 * x + n1 * y + n2
        if abs(along) < GRAZING * np.sqrt(x * x + y * y + 1.0):
            continue
        for down in range(side):
            row = int(np.rint(v + (down - 0.5 * (side - 1)) * CELL_PX))
            for across in range(side):
                column = int(np.rint(u + (across - 0.5 * (side - 1)) * CELL_PX))
                if row < 0 or column < 0 or row >= depth.shape[0] or column >= depth.shape[1]:
                    continue
                there = n0 * (column - lens[2]) / lens[0] + n1 * (row - lens[3]) / lens[1] + n2
                off = abs(depth[row, column] - z * along / there)
                cell = row // CELL_PX, column // CELL_PX
                if depth[row, column] > 0.0 and off < min(tolerance_m, misfit[cell]):
                    misfit[cell] = off
