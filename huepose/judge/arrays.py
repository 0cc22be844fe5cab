"""What the compiled judges read of a model and of a region, and the view from which a pose shows a model."""

from __future__ import annotations

import threading
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from huepose.colorpair.opponents import opponents_of_lab
from huepose.geometry.arrays import Bool, Float32, Float64, Int32
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

COVERAGE_POINTS = 250


class ModelArrays(NamedTuple):
    """The arrays of a model that kernels read (see model.types). colors (2 or more, N, 3) float32: opponents
    averaged over about 1 mm, 3.5 mm and so on; centre (3,) of the bounds of the samples."""

    points: Float32
    normals: Float32
    colors: Float32
    directions: Float32
    visible: Int32
    offsets: Int32
    origin: Float64
    step: float
    nearest: np.ndarray
    centre: Float64


class RegionArrays(NamedTuple):
    """The arrays of a region that kernels read. colors (S, h, w, 3) float32: opponents averaged at the
    model's scales; finest: of the scales of colours, the first of the two that
    are compared; light (3,): what the light adds to opponents, where that is known (`lit`); blind: weight of
    colours where there is no depth to say whether the object is in front."""

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
    finest: int
    light: Float64
    lit: bool
    blind: float


_DARK = np.zeros(3)
_arrays: WeakKeyDictionary[ReferenceModel, ModelArrays] = WeakKeyDictionary()
_lock = threading.Lock()


def model_arrays(model: ReferenceModel) -> ModelArrays:
    """A model's arrays for the kernels, colours as opponents; made once for each model."""
    with _lock:
        found = _arrays.get(model)
        if found is None:
            s, g = model.surface, model.grid
            colors = opponents_of_lab(s.lab)
            found = _arrays[model] = ModelArrays(
                s.points,
                s.normals,
                colors,
                s.directions,
                s.visible,
                s.offsets,
                g.origin,
                float(g.step),
                g.nearest,
                0.5 * (s.points.min(0) + s.points.max(0)).astype(np.float64),
            )
        return found


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
        0,
        _DARK if region.light is None else region.light,
        region.light is not None,
        0.0,
    )


@jit
def nearest_view(T: Float64, model: ModelArrays) -> int:
    """Index of the view direction from which the camera of pose `T` looks at the object's centre."""
    directions, c = model.directions, model.centre
    x, y, z = 0.0, 0.0, 0.0
    for r in range(3):
        eye = -(T[r, 0] * c[0] + T[r, 1] * c[1] + T[r, 2] * c[2] + T[r, 3])
        x += T[r, 0] * eye
        y += T[r, 1] * eye
        z += T[r, 2] * eye
    best, best_dot = 0, -np.inf
    for i in range(directions.shape[0]):
        dot = directions[i, 0] * x + directions[i, 1] * y + directions[i, 2] * z
        if dot > best_dot:
            best, best_dot = i, dot
    return best
