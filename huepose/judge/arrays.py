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
    """The arrays of a model that kernels read (see model.types)."""

    points: Float32
    normals: Float32
    colors: Float32
    directions: Float32
    visible: Int32
    offsets: Int32
    origin: Float64
    step: float
    nearest: np.ndarray


class RegionArrays(NamedTuple):
    """The arrays of a region that kernels read."""

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
    hides: float


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
        region.hides,
    )


@jit
def nearest_view(T: Float64, directions: Float32) -> int:
    """Index of the view direction from which the camera of pose `T` looks at the object's origin."""
    best, best_dot = 0, -np.inf
    x = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
    y = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
    z = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
    for i in range(directions.shape[0]):
        dot = directions[i, 0] * x + directions[i, 1] * y + directions[i, 2] * z
        if dot > best_dot:
            best, best_dot = i, dot
    return best
