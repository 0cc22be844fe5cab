"""The dense score of a pose: does this object, there, explain the depth and the colours of a region?

Samples of the model's surface that the pose shows are compared with the image (depth where the surface
should be, nothing in front of it that we see through, the print's colours), and points of the mask with the
surface (is the mask explained?). Colours are compared by the correlation of their opponents with the
texture's at two scales, so that the light's colour and strength do not matter; lightness also after shading
is taken off.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit
from huepose.verification.color_agreement import color_agreement
from huepose.verification.kernel_arrays import (
    ModelArrays,
    RegionArrays,
    model_arrays,
    nearest_view,
    region_arrays,
)
from huepose.verification.region import Region

TERMS = 8
"""Length of the kernel's output: the fields of PoseScore in order."""


@dataclass(frozen=True)
class ScoreWeights:
    """What each term weighs. `lightness` and `coarse` are relative weights of lightness against the other two
    channels and of the 3.5 mm scale against the 1 mm scale, `outside` of depth that fits outside the mask,
    `color_floor` (units of opponents) keeps the correlation of even surfaces down."""

    depth_fit: float = 0.9
    coverage: float = 0.7
    violation: float = 1.0
    color: float = 1.0
    occluded: float = 0.05
    box: float = 0.5
    lightness: float = 0.8
    coarse: float = 0.5
    outside: float = 0.6
    color_floor: float = 1.5


DEFAULT_WEIGHTS = ScoreWeights()


@dataclass(frozen=True)
class PoseScore:
    """total: the weighted sum, about 0 for nonsense to 3 for a perfect view; depth_fit, coverage, violation,
    occluded, seen, box_iou in 0..1; color in -1..1 (a correlation, lowered where the object has no print)."""

    total: float
    depth_fit: float
    coverage: float
    violation: float
    color: float
    occluded: float
    seen: float
    box_iou: float


def weight_array(weights: ScoreWeights) -> Float64:
    """The weights as the kernels read them, in the order of ScoreWeights."""
    return np.array(astuple(weights), dtype=np.float64)


def score(
    model: ReferenceModel,
    region: Region,
    T_cam_obj: Float,
    samples: int = 800,
    weights: ScoreWeights = DEFAULT_WEIGHTS,
) -> PoseScore:
    """Judge one pose (4, 4) in a region by at most `samples` surface samples."""
    return PoseScore(*(float(x) for x in score_many(model, region, T_cam_obj[None], samples, weights)[0]))


def score_many(
    model: ReferenceModel,
    region: Region,
    poses: Float,
    samples: int = 800,
    weights: ScoreWeights = DEFAULT_WEIGHTS,
) -> Float64:
    """Judge poses (M, 4, 4) in one compiled call: (M, 8), columns in the order of PoseScore's fields."""
    out = np.zeros((len(poses), TERMS))
    _score_all(
        np.ascontiguousarray(poses, dtype=np.float64),
        model_arrays(model),
        region_arrays(region),
        samples,
        weight_array(weights),
        out,
    )
    return out


@jit
def _score_all(
    poses: Float64, model: ModelArrays, region: RegionArrays, samples: int, weights: Float64, out: Float64
) -> None:
    moments = np.empty((6, 5))
    for i in range(poses.shape[0]):
        score_kernel(poses[i], model, region, samples, weights, moments, out[i])


@jit
def score_kernel(
    T: Float64,
    model: ModelArrays,
    region: RegionArrays,
    samples: int,
    weights: Float64,
    moments: Float64,
    out: Float64,
) -> float:
    """Judge one pose; `moments` (6, 5) is scratch, `out` (8,) gets the terms, the total is returned."""
    w_fit, w_coverage, w_violation, w_color = weights[0], weights[1], weights[2], weights[3]
    w_occluded, w_box, w_outside = weights[4], weights[5], weights[8]
    points, normals, prints = model.points, model.normals, model.colors
    depth, belief, colors, saturated = region.depth, region.belief, region.colors, region.saturated
    height, width = depth.shape
    tolerance = region.tolerance
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    fit, near, violation, occluded, total, color_weight = 0.0, 0.0, 0.0, 0.0, 1e-9, 0.0
    left, top, right, bottom = 1e9, 1e9, -1e9, -1e9
    moments[:] = 0.0
    shading = np.zeros((7, 3))

    view = nearest_view(T, model.directions)
    first = model.offsets[view]
    for k in range(first, min(model.offsets[view + 1], first + samples)):
        i = model.visible[k]
        s0, s1, s2 = points[i, 0], points[i, 1], points[i, 2]
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        x = r00 * s0 + r01 * s1 + r02 * s2 + t0
        y = r10 * s0 + r11 * s1 + r12 * s2 + t1
        z = r20 * s0 + r21 * s1 + r22 * s2 + t2
        if z < 0.02:
            continue
        m0 = r00 * n0 + r01 * n1 + r02 * n2
        m1 = r10 * n0 + r11 * n1 + r12 * n2
        m2 = r20 * n0 + r21 * n1 + r22 * n2
        facing = -(m0 * x + m1 * y + m2 * z) / np.sqrt(x * x + y * y + z * z)
        if facing < 0.1:
            continue
        total += facing
        uf, vf = x / z * region.fx + region.cx, y / z * region.fy + region.cy
        if uf < -0.5 or vf < -0.5 or uf >= width - 0.5 or vf >= height - 0.5:
            continue
        u, v = int(uf + 0.5), int(vf + 0.5)
        observed = depth[v, u]
        # Distance along the ray, measured across the surface: slanted surfaces forgive more.
        gap = (observed - z) * facing
        fits = abs(gap) < tolerance
        if observed == 0.0 or fits:
            left, right, top, bottom = min(left, uf), max(right, uf), min(top, vf), max(bottom, vf)
        if observed == 0.0:
            continue
        if fits:
            g = facing * (w_outside + (1.0 - w_outside) * belief[v, u])
            fit += g * (1.0 - (gap / tolerance) ** 2)
            near += facing
            if saturated[v, u]:
                continue
            color_weight += g
            u0, v0 = min(max(int(np.floor(uf)), 0), width - 2), min(max(int(np.floor(vf)), 0), height - 2)
            a, b = min(max(uf - u0, 0.0), 1.0), min(max(vf - v0, 0.0), 1.0)
            c00, c01, c10, c11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            for q in range(6):
                model_color = prints[q // 3, i, q % 3]
                image_color = (
                    c00 * colors[v0, u0, q]
                    + c01 * colors[v0, u0 + 1, q]
                    + c10 * colors[v0 + 1, u0, q]
                    + c11 * colors[v0 + 1, u0 + 1, q]
                )
                moments[q, 0] += g * model_color
                moments[q, 1] += g * image_color
                moments[q, 2] += g * model_color * model_color
                moments[q, 3] += g * image_color * image_color
                moments[q, 4] += g * model_color * image_color
                if q % 3 == 0:
                    row = 3 + 2 * (q // 3)
                    gm, gi = g * model_color, g * image_color
                    shading[row, 0] += gm * m0
                    shading[row, 1] += gm * m1
                    shading[row, 2] += gm * m2
                    shading[row + 1, 0] += gi * m0
                    shading[row + 1, 1] += gi * m1
                    shading[row + 1, 2] += gi * m2
            shading[0, 0] += g * m0
            shading[0, 1] += g * m1
            shading[0, 2] += g * m2
            shading[1, 0] += g * m0 * m0
            shading[1, 1] += g * m1 * m1
            shading[1, 2] += g * m2 * m2
            shading[2, 0] += g * m0 * m1
            shading[2, 1] += g * m0 * m2
            shading[2, 2] += g * m1 * m2
        elif gap > 0.0:
            violation += facing  # We see through the model.
        else:
            # What is in front hides the object, unless it is believed to be the object itself.
            violation += 0.5 * facing * belief[v, u]
            occluded += facing * (1.0 - belief[v, u])

    out[1] = fit / (near + violation + 0.15 * total)
    out[2] = _coverage(T, model, region.points_cam, region.point_weights, tolerance)
    out[3] = violation / (near + violation + 0.15 * total)
    out[4] = color_agreement(moments, shading, color_weight, weights) if color_weight > 0.02 * total else 0.0
    out[5] = occluded / total
    out[6] = near / total
    out[7] = _box_iou(left, top, right, bottom, region.bounds)
    out[0] = (
        w_fit * out[1]
        + w_coverage * region.trust * out[2]
        - w_violation * out[3]
        + w_color * out[4]
        - w_occluded * out[5]
        + w_box * out[7]
    )
    return float(out[0])


@jit
def _coverage(
    T: Float64, model: ModelArrays, points_cam: Float64, point_weights: Float64, tolerance: float
) -> float:
    """Share of the believed points that lie on the side of the surface which the camera sees."""
    points, normals, nearest, origin, step = (
        model.points,
        model.normals,
        model.nearest,
        model.origin,
        model.step,
    )
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    covered, total = 0.0, 1e-9
    for i in range(points_cam.shape[0]):
        total += point_weights[i]
        p0, p1, p2 = points_cam[i, 0], points_cam[i, 1], points_cam[i, 2]
        x, y, z = p0 - t0, p1 - t1, p2 - t2
        q0 = r00 * x + r10 * y + r20 * z
        q1 = r01 * x + r11 * y + r21 * z
        q2 = r02 * x + r12 * y + r22 * z
        a0 = int(np.floor((q0 - origin[0]) / step + 0.5))
        a1 = int(np.floor((q1 - origin[1]) / step + 0.5))
        a2 = int(np.floor((q2 - origin[2]) / step + 0.5))
        if a0 < 0 or a1 < 0 or a2 < 0:
            continue
        if a0 >= nearest.shape[0] or a1 >= nearest.shape[1] or a2 >= nearest.shape[2]:
            continue
        j = nearest[a0, a1, a2]
        n0, n1, n2 = normals[j, 0], normals[j, 1], normals[j, 2]
        e0, e1, e2 = q0 - points[j, 0], q1 - points[j, 1], q2 - points[j, 2]
        away = (
            (r00 * n0 + r01 * n1 + r02 * n2) * p0
            + (r10 * n0 + r11 * n1 + r12 * n2) * p1
            + (r20 * n0 + r21 * n1 + r22 * n2) * p2
        )
        if away > 0.0:
            continue
        gap = abs(e0 * n0 + e1 * n1 + e2 * n2)
        if gap < tolerance and e0 * e0 + e1 * e1 + e2 * e2 < 9.0 * tolerance * tolerance:
            covered += point_weights[i] * (1.0 - (gap / tolerance) ** 2)
    return float(covered / total)


@jit
def _box_iou(left: float, top: float, right: float, bottom: float, bounds: Float64) -> float:
    w = min(right, bounds[2]) - max(left, bounds[0])
    h = min(bottom, bounds[3]) - max(top, bounds[1])
    if w <= 0.0 or h <= 0.0:
        return 0.0
    area = (right - left) * (bottom - top) + (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
    return float(w * h / (area - w * h))
