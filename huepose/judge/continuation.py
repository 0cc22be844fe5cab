"""Does the surface go on where the object ends? Then the object is not there, only its texture or its
shape."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.judge.arrays import ModelArrays, nearest_view
from huepose.support.jit import jit

SIDE = 20
"""Cells along the longer side of an object's outline."""

INNER, OUTER = 1, 2
"""The rim is what lies so many cells outside of the outline."""

TOLERANCE_M = 0.012


def continuation_many(
    model: ModelArrays, depth: Float32, clear: Bool, camera: Camera, poses: Float64, samples: int
) -> Float64:
    """Share (M,) of the rim of each pose (M, 4, 4) where the surface that is seen goes on from the object's.

    depth (h, w) metres, 0 = none; clear (h, w): pixels that can be an object's at all; at most `samples` of
    the surface draw the outline."""
    out = np.zeros(len(poses))
    _continue(
        np.ascontiguousarray(poses), model, clear, depth,
        camera.fx, camera.fy, camera.cx, camera.cy, samples, out,
    )  # fmt: skip
    return out


@jit
def _continue(
    poses: Float64,
    model: ModelArrays,
    clear: Bool,
    depth: Float32,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    samples: int,
    out: Float64,
) -> None:
    n = SIDE + 2 * OUTER + 1
    height, width = depth.shape
    inside = np.empty((n, n))
    seen = np.empty((samples, 3))
    for m in range(poses.shape[0]):
        T = poses[m]
        first = model.offsets[nearest_view(T, model)]
        last = min(model.offsets[nearest_view(T, model) + 1], first + samples)
        count = 0
        left, top, right, bottom = 1e9, 1e9, -1e9, -1e9
        for k in range(first, last):
            p = model.points[model.visible[k]]
            z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
            if z < 0.05:
                continue
            u = (T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]) / z * fx + cx
            v = (T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]) / z * fy + cy
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
            seen[count, 0], seen[count, 1], seen[count, 2] = u, v, z
            count += 1
        if count < 8:
            continue
        cell = max((right - left) / SIDE, (bottom - top) / SIDE, 1.0)
        inside[:] = 0.0
        for k in range(count):
            x, y = int((seen[k, 0] - left) / cell) + OUTER, int((seen[k, 1] - top) / cell) + OUTER
            inside[y, x] = seen[k, 2]
        total, on = 1e-9, 0.0
        for y in range(n):
            for x in range(n):
                near = 0.0
                apart = OUTER + 1
                for b in range(max(y - OUTER, 0), min(y + OUTER + 1, n)):
                    for a in range(max(x - OUTER, 0), min(x + OUTER + 1, n)):
                        if inside[b, a] > 0.0 and max(abs(b - y), abs(a - x)) < apart:
                            apart = max(abs(b - y), abs(a - x))
                            near = inside[b, a]
                if apart <= INNER or apart > OUTER:
                    continue
                u, v = int(left + (x - OUTER + 0.5) * cell + 0.5), int(top + (y - OUTER + 0.5) * cell + 0.5)
                if u < 0 or v < 0 or u >= width or v >= height or depth[v, u] == 0.0:
                    continue
                total += 1.0
                tolerance = TOLERANCE_M + 1.5 * cell * near / fx
                if clear[v, u] and abs(depth[v, u] - near) < tolerance:
                    on += 1.0
        out[m] = on / total
