"""The arrays of a model and of a region as compiled kernels read them, and what every kernel needs: the pixel
of a sample, the samples that are visible at a pose, the tolerance of depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.colorpair.opponents import opponents_of_lab
from huepose.geometry import icosphere
from huepose.geometry.arrays import Bool, Float32, Float64, Int32, Int64
from huepose.geometry.camera import FLOOR_M, NEAREST_M, STEREO_NOISE_PER_M
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit, jit_dividing
from huepose.support.kept import once_for_each

GRAZING = 0.1
"""Cosine of the viewing angle below which a sample is too oblique to be compared with depth."""

COVERAGE_POINTS = 250
"""Mask points that coverage is computed from."""


class ModelArrays(NamedTuple):
    """The arrays of a model that kernels read (see model.types). colors (2 or more, N, 3) float32: opponents
    averaged over about 1 mm, 3.5 mm and so on; beside (V, 6): `icosphere.neighbours` of the directions,
    (V, 0) where these are no icosphere; centre (3,) of the bounds of the samples."""

    points: Float32
    normals: Float32
    colors: Float32
    directions: Float32
    beside: Int32
    visible: Int32
    offsets: Int32
    origin: Float64
    step: float
    nearest: np.ndarray
    centre: Float64


NO_LIGHT = np.zeros(3)


class RegionArrays(NamedTuple):
    """The arrays of a region that kernels read. colors (S, h, w, 3) float32: opponents averaged at the
    model's scales; finest: index of the first of the two colour scales that are compared; light (3,): offset
    that the light adds to opponents, if it is known (`lit`); blind: weight of colours where no depth shows
    whether the object is occluded; sigmas: see `tolerance_at`."""

    points_cam: Float64
    point_weights: Float64
    trust: float
    depth: Float32
    belief: Float32
    colors: Float32
    saturated: Bool
    fx: float
    fy: float
    cx: float
    cy: float
    bounds: Float64
    tolerance: float
    finest: int = 0
    light: Float64 = NO_LIGHT
    lit: bool = False
    blind: float = 0.0
    sigmas: float = 0.0


@once_for_each
def model_arrays(model: ReferenceModel) -> ModelArrays:
    """A model's arrays for the kernels, colours as opponents; made once for each model."""
    s, g = model.surface, model.grid
    colors = opponents_of_lab(s.lab)
    return ModelArrays(
        s.points,
        s.normals,
        colors,
        s.directions,
        beside(s.directions),
        s.visible,
        s.offsets,
        g.origin,
        float(g.step),
        g.nearest,
        s.centre,
    )


def beside(directions: Float32) -> Int32:
    """The neighbours of directions (V, 3), for `ModelArrays`."""
    for level in (2, 3):
        sphere = icosphere.directions(level)
        if sphere.shape == directions.shape and np.allclose(sphere, directions, atol=1e-6):
            return icosphere.neighbours(level)
    return np.empty((len(directions), 0), np.int32)


def region_arrays(region: Region) -> RegionArrays:
    """Bundle a region's arrays for the kernels."""
    camera = region.crop.camera
    return RegionArrays(
        region.points_cam[:COVERAGE_POINTS],
        region.point_weights[:COVERAGE_POINTS],
        float(region.trust),
        region.crop.depth,
        region.belief,
        region.colors,
        region.crop.saturated,
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        region.bounds,
        region.tolerance_m,
        sigmas=region.sigmas,
    )


@jit_dividing
def tolerance_at(tolerance_m: float, sigmas: float, depth_m: float) -> float:
    """A tolerance, metres, but at least `sigmas` standard errors of a reading at that depth."""
    return max(tolerance_m, sigmas * (FLOOR_M + STEREO_NOISE_PER_M * depth_m * depth_m))


@jit_dividing
def projected(T: Float64, points: Float32, i: int, lens: Float64) -> tuple[float, float, float]:
    """Pixel and depth of point i of (N, 3) at pose T (4, 4); behind the camera the pixel has no meaning. lens
    (4,): fx, fy, cx, cy."""
    p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
    z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
    u = (T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]) / z * lens[0] + lens[2]
    v = (T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]) / z * lens[1] + lens[3]
    return u, v, z


FIRST_VIEWS = 42
"""Directions of an icosphere that are compared first: those of its first levels. From the best of them the
search goes from neighbour to neighbour."""


@jit
def nearest_view(T: Float64, model: ModelArrays) -> int:
    """Index of the view direction from which the camera of pose `T` looks at the object's centre."""
    directions, beside, c = model.directions, model.beside, model.centre
    x, y, z = 0.0, 0.0, 0.0
    for r in range(3):
        eye = -(T[r, 0] * c[0] + T[r, 1] * c[1] + T[r, 2] * c[2] + T[r, 3])
        x += T[r, 0] * eye
        y += T[r, 1] * eye
        z += T[r, 2] * eye
    best, best_dot = 0, -np.inf
    for i in range(FIRST_VIEWS if beside.shape[1] else directions.shape[0]):
        dot = directions[i, 0] * x + directions[i, 1] * y + directions[i, 2] * z
        if dot > best_dot:
            best, best_dot = i, dot
    here = -1
    while here != best:
        here = best
        for k in range(beside.shape[1]):
            i = beside[here, k]
            dot = directions[i, 0] * x + directions[i, 1] * y + directions[i, 2] * z
            if dot > best_dot:
                best, best_dot = i, dot
    return best


@jit
def shown_range(T: Float64, model: ModelArrays, most: int) -> tuple[int, int]:
    """Begin and end, in `model.visible`, of the samples that are visible at pose `T`, at most `most` of
    them."""
    view = nearest_view(T, model)
    first = model.offsets[view]
    return first, min(model.offsets[view + 1], first + most)


class SeenSamples(NamedTuple):
    """The samples of a surface that depth confirms at a pose. which (N,): their indices; facing (N,): cosine
    between normal and line of sight; u, v (N,): position in the image; row, column (N,): nearest pixel."""

    which: Int32
    facing: Float64
    u: Float64
    v: Float64
    row: Int64
    column: Int64


def seen_samples(model: ModelArrays, region: RegionArrays, T: Float64, most: int) -> SeenSamples:
    """Those of the first `most` samples visible at pose `T` where depth agrees and the colour is known."""
    first, last = shown_range(T, model, most)
    index, R = model.visible[first:last], T[:3, :3]
    points, normals = model.points[index] @ R.T + T[:3, 3], model.normals[index] @ R.T
    facing = -(normals * points).sum(1) / np.linalg.norm(points, axis=1)
    z = np.maximum(points[:, 2], NEAREST_M)
    u, v = points[:, 0] / z * region.fx + region.cx, points[:, 1] / z * region.fy + region.cy
    height, width = region.depth.shape
    inside = (facing > GRAZING) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    column, row = (np.where(inside, x + 0.5, 0.0).astype(np.int64) for x in (u, v))
    depth = region.depth[row, column]
    away_m = float(points[:, 2].mean()) if len(points) else 0.0
    tolerance = tolerance_at(region.tolerance, region.sigmas, away_m)
    seen = inside & (depth > 0) & (np.abs(depth - points[:, 2]) * facing < tolerance)
    seen &= ~region.saturated[row, column]
    return SeenSamples(index[seen], facing[seen], u[seen], v[seen], row[seen], column[seen])
