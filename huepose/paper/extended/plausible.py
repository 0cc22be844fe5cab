"""Is there depth where a pose puts the object's surface? A cheap test for thousands of votes.

Colours propose many poses that contradict depth: the surface would be in front of the measured depth, or
outside the mask. Forty surface samples are enough; the test takes about half a microsecond for each vote.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float32
from huepose.geometry.camera import NEAR_M, Camera
from huepose.model.types import Surface
from huepose.paper.votes import Votes
from huepose.support.jit import jit

SAMPLES = 40
"""Surface samples of a pose."""

GLANCE = 14
"""Number of samples after which a vote with clearly more against it than for it is rejected: most are."""

TOLERANCE = 0.06
"""Depth and surface agree up to this distance, in diameters: votes are coarse."""

LEAST_FACING = 0.15
"""A sample is used if the cosine between its normal and the line of sight is at least this."""

OUTSIDE = 0.3
"""Weight against the pose of a sample whose depth fits but whose pixel is not in the mask."""

HIDDEN = 0.5
"""Weight against the pose of a sample that lies behind the depth in the mask."""

LEAST = 0.1
"""A vote needs a share above this."""


def plausible(
    votes: Votes, surface: Surface, depth: Float32, mask: Bool, camera: Camera, diameter_m: float
) -> Votes:
    """The votes that agree with depth, their weights multiplied by the share (0..1) of samples that agree.

    depth, mask (H, W) of the camera. The share is that of the samples facing the camera that lie on the depth
    inside the mask, less those with a free-space violation, outside the mask, or behind the depth in it.
    """
    if not len(votes):
        return votes
    share = _shares(
        votes.rotations,
        votes.translations,
        np.ascontiguousarray(surface.points[:SAMPLES]),
        np.ascontiguousarray(surface.normals[:SAMPLES]),
        np.ascontiguousarray(depth),
        np.ascontiguousarray(mask),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        TOLERANCE * diameter_m,
    )
    kept = share > LEAST
    weights = (votes.weights * share)[kept]
    return Votes(votes.rotations[kept], votes.translations[kept], weights, votes.features[kept])


@jit
def _shares(
    R: Float32,
    t: Float32,
    points: Float32,
    normals: Float32,
    depth: Float32,
    mask: Bool,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    tolerance: float,
) -> Float32:
    out = np.zeros(R.shape[0], np.float32)
    height, width = depth.shape
    for k in range(R.shape[0]):
        r00, r01, r02 = R[k, 0, 0], R[k, 0, 1], R[k, 0, 2]
        r10, r11, r12 = R[k, 1, 0], R[k, 1, 1], R[k, 1, 2]
        r20, r21, r22 = R[k, 2, 0], R[k, 2, 1], R[k, 2, 2]
        fit, against, total = 0.0, 0.0, 0.0
        for i in range(points.shape[0]):
            if i == GLANCE and against > fit + 1.0:
                fit = 0.0
                break
            p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
            n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
            x = r00 * p0 + r01 * p1 + r02 * p2 + t[k, 0]
            y = r10 * p0 + r11 * p1 + r12 * p2 + t[k, 1]
            z = r20 * p0 + r21 * p1 + r22 * p2 + t[k, 2]
            if z < NEAR_M:
                continue
            away = (
                (r00 * n0 + r01 * n1 + r02 * n2) * x
                + (r10 * n0 + r11 * n1 + r12 * n2) * y
                + (r20 * n0 + r21 * n1 + r22 * n2) * z
            )
            facing = -away / np.sqrt(x * x + y * y + z * z)
            if facing < LEAST_FACING:
                continue
            total += facing
            u, v = int(np.floor(x / z * fx + cx + 0.5)), int(np.floor(y / z * fy + cy + 0.5))
            if u < 0 or v < 0 or u >= width or v >= height:
                continue
            observed = depth[v, u]
            if observed <= 0.0:
                continue
            gap = observed - z
            if abs(gap) < tolerance:
                if mask[v, u]:
                    fit += facing
                else:
                    against += OUTSIDE * facing
            elif gap > 0.0:
                against += facing
            elif mask[v, u]:
                against += HIDDEN * facing
        if total > 0.0:
            out[k] = max(0.0, (fit - against) / total)
    return out
