"""Factor: visible samples of the model onto the depth image, along their normals.

Correspondences are projective: a sample is compared with the reading of the pixel that it falls on (Blais and
Levine 1995). It needs no scene points and no search, but a pose that is already close.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.camera import NEAREST_M, Camera
from huepose.model.types import Surface
from huepose.refine.robust import tukey
from huepose.refine.solver import Body, NormalEquations, add_residual, motion_row
from huepose.support.jit import jit_dividing


class DepthImage(NamedTuple):
    """depth (h, w) metres, 0 = nothing; camera (4,): its fx, fy, cx, cy."""

    depth: Float32
    camera: Float64


class DepthSamples(NamedTuple):
    """points (N, 3) and normals (N, 3) of the model, object axes; weight of each."""

    points: Float32
    normals: Float32
    weight: float


def depth_image(depth: Float32, camera: Camera) -> DepthImage:
    """Bundle a depth image's arrays for the kernels."""
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return DepthImage(np.ascontiguousarray(depth), lens)


def depth_samples(surface: Surface, T_cam_obj: Float64, count: int, weight: float) -> DepthSamples:
    """At most `count` samples of a surface that a view from the camera's side shows."""
    looked = -T_cam_obj[:3, :3].T @ T_cam_obj[:3, 3]
    view = int(np.argmax(surface.directions @ looked))
    shown = surface.visible[surface.offsets[view] : surface.offsets[view + 1]][:count]
    return DepthSamples(
        np.ascontiguousarray(surface.points[shown]), np.ascontiguousarray(surface.normals[shown]), weight
    )


@jit_dividing
def add_depth_samples(
    T: Float64,
    samples: DepthSamples,
    image: DepthImage,
    body: Body,
    gate_m: float,
    equations: NormalEquations,
) -> float:
    """Add the distances along the normals of the samples within `gate_m`; returns their weight."""
    depth, points, normals = image.depth, samples.points, samples.normals
    fx, fy, cx, cy = image.camera[0], image.camera[1], image.camera[2], image.camera[3]
    height, width = depth.shape
    total = 0.0
    for i in range(points.shape[0]):
        p0, p1, p2 = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        x = T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]
        y = T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]
        z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
        if z < NEAREST_M:
            continue
        u, v = int(x / z * fx + cx + 0.5), int(y / z * fy + cy + 0.5)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        seen = depth[v, u]
        if seen <= 0.0:
            continue
        e0, e1, e2 = (u - cx) / fx * seen - x, (v - cy) / fy * seen - y, seen - z
        n0, n1, n2 = np.float64(normals[i, 0]), np.float64(normals[i, 1]), np.float64(normals[i, 2])
        m0 = T[0, 0] * n0 + T[0, 1] * n1 + T[0, 2] * n2
        m1 = T[1, 0] * n0 + T[1, 1] * n1 + T[1, 2] * n2
        m2 = T[2, 0] * n0 + T[2, 1] * n1 + T[2, 2] * n2
        distance = m0 * e0 + m1 * e1 + m2 * e2
        w = samples.weight * tukey((distance / gate_m) ** 2)
        if w > 0.0:
            add_residual(equations, w, distance, motion_row(p0, p1, p2, n0, n1, n2, body))
            total += w
    return total
