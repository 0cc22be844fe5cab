"""How much likelier the hues that are seen are the object's than anything's, in a light that is known or not.

A correlation of colours asks whether a pattern is there; this asks whether the colours themselves are. How
much a colour says depends on how common it is: grey is everywhere, a strong red is not. Light adds a constant
to the opponents of everything in a frame (von Kries)."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.judge.arrays import ModelArrays, nearest_view
from huepose.support.jit import jit

HUES = 120
"""Samples of the surface that are looked at, about."""

LEAST_HUES = 5
FACING = 0.1

LEAST, MOST = -3.0, 5.0
"""Hue says no more than this, in natural logarithms: its errors are not independent."""

NOISE, NOISE_SHARE = 4.0, 0.15
"""Deviation of a hue from the object's, units of opponents: so much, and this share of its distance from
grey."""

ODD, ODD_SPREAD = 0.05, 45.0
"""Share of samples whose hue is anything (glare, dirt, a reflection), and the spread of that."""

WORLD_SHARES, WORLD_SPREADS = (0.35, 0.4, 0.25), (8.0, 20.0, 45.0)
"""Hues of things under white light: much is grey, little is strongly coloured."""


def hue_samples(
    model: ModelArrays,
    depth: Float32,
    colors: Float32,
    saturated: Bool,
    camera: Camera,
    tolerance_m: float,
    T_cam_obj: Float64,
) -> Float64:
    """Of the samples of a pose (4, 4) that fit the depth (h, w): (N, 5) weight, the object's red-green and
    yellow-blue, and those of the image. colors (h, w, 6 or more): opponents, the second scale is read."""
    out = np.empty((4 * HUES, 5))
    count = _fill(
        np.ascontiguousarray(T_cam_obj, dtype=np.float64), model, depth, colors, saturated,
        camera.fx, camera.fy, camera.cx, camera.cy, tolerance_m, out,
    )  # fmt: skip
    return out[:count]


@jit
def _fill(
    T: Float64,
    model: ModelArrays,
    depth: Float32,
    colors: Float32,
    saturated: Bool,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    tolerance: float,
    out: Float64,
) -> int:
    height, width = depth.shape
    view = nearest_view(T, model)
    first, last = model.offsets[view], model.offsets[view + 1]
    stride = max(1, (last - first) // (2 * HUES))
    count = 0
    for k in range(first, last, stride):
        p, m = model.points[model.visible[k]], model.normals[model.visible[k]]
        x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z < 0.02:
            continue
        away = (T[0, 0] * m[0] + T[0, 1] * m[1] + T[0, 2] * m[2]) * x
        away += (T[1, 0] * m[0] + T[1, 1] * m[1] + T[1, 2] * m[2]) * y
        away += (T[2, 0] * m[0] + T[2, 1] * m[1] + T[2, 2] * m[2]) * z
        facing = -away / np.sqrt(x * x + y * y + z * z)
        if facing <= FACING:
            continue
        u, v = int(np.rint(x / z * fx + cx)), int(np.rint(y / z * fy + cy))
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        if depth[v, u] <= 0.0 or saturated[v, u] or abs((depth[v, u] - z) * facing) >= tolerance:
            continue
        if count == out.shape[0]:
            break
        own = model.colors[1, model.visible[k]]
        out[count, 0], out[count, 1], out[count, 2] = facing, own[1], own[2]
        out[count, 3], out[count, 4] = colors[v, u, 4], colors[v, u, 5]
        count += 1
    return count


def hue_log_ratio(hues: Float64, light: Float64, spread: float) -> float:
    """How much likelier the hues (N, 5) of `hue_samples` are the object's than anything's, as a mean log
    ratio, in a light that adds `light` (2,) to them, known to within `spread`; 0 where hardly any is seen."""
    if len(hues) < LEAST_HUES:
        return 0.0
    weights, own, shown = hues[:, 0], hues[:, 1:3], hues[:, 3:] - light
    variance = (NOISE + NOISE_SHARE * np.linalg.norm(own, axis=1)) ** 2 + spread**2
    away = ((shown - own) ** 2).sum(1)
    # Student's t of three degrees of freedom, in the plane.
    likely = (1.0 - ODD) / (2.0 * np.pi * variance) * (1.0 + away / (3.0 * variance)) ** -2.5
    likely += ODD * _round_normal(away, ODD_SPREAD)
    common = (shown**2).sum(1)
    anything = sum(a * _round_normal(common, s) for a, s in zip(WORLD_SHARES, WORLD_SPREADS, strict=True))
    ratio = np.log(likely) - np.log(anything + 1e-9)
    return float(np.clip(np.average(ratio, weights=weights), LEAST, MOST))


def _round_normal(away: Float64, spread: float) -> Float64:
    """Density of a round normal distribution in the plane at squared distances (N,)."""
    return np.asarray(np.exp(-away / (2.0 * spread**2)) / (2.0 * np.pi * spread**2))
