"""Rim agreement: does the image have an edge where the outline of a pose lies?

Thin and distant objects have hardly any relief that separates them from their surroundings, but their outline
in colour is sharp. Only the direction of a gradient counts fully: noise and clutter have strong gradients,
but rarely along the rim (observation of LINEMOD, Hinterstoisser et al. 2012).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.geometry.camera import NEAREST_M
from huepose.judge.kernel_arrays import RegionArrays, tolerance_at
from huepose.support.jit import jit_dividing

SMOOTHING_PX = 1.0
"""Sigma by which the image is smoothed before its gradient is taken."""

FAINT = 3.0
"""Gradient that counts half, opponent units per pixel: fainter ones are noise."""

REACH_PX = 1
"""Search range for the strongest edge across the outline, pixels."""

OCCLUDED = 1.5
"""A rim point is occluded if depth lies in front of it by this many tolerances."""

PRIOR, PRIOR_COUNT = 0.35, 10.0
"""Prior: agreement of a rim at a random place, and the number of points that this prior counts as."""


class Rim(NamedTuple):
    """An outline to compare. points (N, 3): object axes; inward (N, 3): from each point to one pixel further
    inside, object axes; edges (h, w, 3): structure tensor of the image, xx, xy, yy; weight: of the agreement
    in a total, 0 without a rim."""

    points: Float64
    inward: Float64
    edges: Float32
    weight: float


NO_RIM = Rim(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((1, 1, 3), np.float32), 0.0)


def edge_tensor(color: UInt8) -> Float32:
    """Structure tensor (h, w, 3), as xx, xy, yy, of an image's opponents, summed over the channels."""
    smooth = cv2.GaussianBlur(opponents_of_bytes(color), (0, 0), SMOOTHING_PX)
    x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    tensor = np.stack([(x * x).sum(-1), (x * y).sum(-1), (y * y).sum(-1)], axis=-1)
    return np.ascontiguousarray(tensor, dtype=np.float32)


@jit_dividing
def rim_agreement(T: Float64, rim: Rim, region: RegionArrays) -> float:
    """Agreement 0..1 of the image's gradients with the outline of pose T (4, 4), without occluded points."""
    height, width = region.depth.shape
    total, count = PRIOR * PRIOR_COUNT, PRIOR_COUNT
    for i in range(rim.points.shape[0]):
        p0, p1, p2 = rim.points[i, 0], rim.points[i, 1], rim.points[i, 2]
        z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
        if z < NEAREST_M:
            continue
        u = (T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]) / z * region.fx + region.cx
        v = (T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]) / z * region.fy + region.cy
        if u < 1.5 or v < 1.5 or u >= width - 2.5 or v >= height - 2.5:
            continue
        observed = region.depth[int(v + 0.5), int(u + 0.5)]
        if observed > 0.0 and observed < z - OCCLUDED * tolerance_at(region.tolerance, region.sigmas, z):
            continue
        q0, q1, q2 = rim.inward[i, 0], rim.inward[i, 1], rim.inward[i, 2]
        x = T[0, 0] * q0 + T[0, 1] * q1 + T[0, 2] * q2
        y = T[1, 0] * q0 + T[1, 1] * q1 + T[1, 2] * q2
        length = np.sqrt(x * x + y * y) + 1e-12
        x, y = x / length, y / length
        best = 0.0
        for k in range(-REACH_PX, REACH_PX + 1):
            a, b = int(u + k * x + 0.5), int(v + k * y + 0.5)
            xx, xy, yy = rim.edges[b, a, 0], rim.edges[b, a, 1], rim.edges[b, a, 2]
            strength = np.sqrt(xx + yy) + 1e-6
            across = (xx * x * x + 2.0 * xy * x * y + yy * y * y) / (strength * (strength + FAINT))
            best = max(best, across)
        total += best
        count += 1.0
    return float(total / count)
