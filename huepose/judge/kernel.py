"""The dense score of one pose, compiled: computes `judge.terms.Terms` in passes over the visible samples.

The samples are projected and compared with depth. Where depth fits, their colours are compared with the
image. Each pass is a plain loop over rows of a scratch array, with a weight in place of a branch, so that the
compiler can vectorise it. A caller that only needs to know whether a pose is better than another passes
`needed`, and the kernel stops as soon as the pose cannot reach it.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.camera import NEAREST_M
from huepose.judge.color_correlation import color_agreement
from huepose.judge.kernel_arrays import GRAZING, ModelArrays, RegionArrays, nearest_view, tolerance_at
from huepose.judge.weights import ScoreWeights
from huepose.support.jit import jit_dividing

TERMS = 17
"""Length of the kernel's output: the fields of `terms.Terms` in order."""

SCRATCH_ROWS = 23
"""Rows of the scratch array. For all samples: 0 facing, 1..2 pixel, 3 depth, 4..6 normal in camera axes, 7
weight in colour, 8 reading, 9 belief, 10 whether the colour is known, 11 whether it is in the image, later
its facing where it may show the object, 20 index of the pixel. For samples with a weight, compacted: 4..6
normal, 7 weight, 8..13 colours of the texture, 14..19 of the image, 20 index of the sample, 21..22 pixel."""

STICKING = 3.0
"""A surface less than this many tolerances behind the measured one counts as penetrating it, not as occluded.
Solid objects do not penetrate each other: a pose must not pass as occluded by sinking into its support or its
neighbour."""

IMPLAUSIBLE = 0.5
"""Weight of a sample that is implausibly occluded: it penetrates something, or lies behind what is believed
to be the object itself. A free-space violation has weight 1."""

MARGIN = 0.15
"""Share of the surface that is added to the denominator of ratios, so that a pose with little in view
explains little."""

SEEN_IN_COLOR = 0.02
"""Share of the surface whose colour must be visible for colours to be compared."""


FAR = 1e9
"""Where a plane was removed, depth counts as this many tolerances behind a sample."""

BLOCK = 64
"""Mask points per block when coverage is computed; after each block it stops if the result is already
decided."""


@jit_dividing
def score_kernel(
    T: Float64,
    model: ModelArrays,
    region: RegionArrays,
    samples: int,
    weights: ScoreWeights,
    scratch: Float64,
    out: Float64,
    needed: float,
) -> float:
    """Judge one pose T (4, 4). Writes the terms to `out` (TERMS,) and returns the total; scratch:
    (SCRATCH_ROWS, samples).

    If the total cannot exceed `needed`, the kernel may stop early. It then returns an upper bound of the
    total that is not over `needed`, and `out` is undefined.
    """
    c = model.centre
    away = T[2, 0] * c[0] + T[2, 1] * c[1] + T[2, 2] * c[2] + T[2, 3]
    tolerance = tolerance_at(region.tolerance, region.sigmas, away)
    view = nearest_view(T, model)
    first = model.offsets[view]
    seen = min(model.offsets[view + 1] - first, samples)
    _place(T, model, region, first, seen, scratch)
    _look_up(region, seen, scratch)
    total, color_weight = _compare(region, seen, tolerance, weights.outside, scratch, out)
    out[12], out[13], out[14], out[15] = 0.0, 0.0, 0.0, 0.0
    known = (
        weights.depth_fit * out[1]
        - weights.violation * out[3]
        - weights.occluded * out[5]
        + weights.box * out[7]
    )
    full_coverage, full_color = max(weights.coverage * region.trust, 0.0), abs(weights.color)
    if known + full_coverage + full_color <= needed:
        return float(known + full_coverage + full_color)
    has_color = weights.color != 0.0 and color_weight > SEEN_IN_COLOR * total
    out[4] = 0.0
    if has_color:
        fitting = _compacted(model, first, seen, scratch)
        _read_colors(model, region, fitting, scratch)
        out[4] = color_agreement(scratch, fitting, color_weight, weights, region, out[12:])
    known += weights.color * out[4]
    if known + full_coverage <= needed:
        return float(known + full_coverage)
    enough = (needed - known) / full_coverage if full_coverage > 0.0 else -np.inf
    out[2] = _coverage(T, model, region, enough, scratch)
    out[0] = known + weights.coverage * region.trust * out[2]
    return float(out[0])


@jit_dividing
def _place(
    T: Float64, model: ModelArrays, region: RegionArrays, first: int, count: int, scratch: Float64
) -> None:
    """Compute facing (0 behind the camera), pixel, depth and normal of the visible samples of a view. Each
    plain loop uses few rows, because the compiler cannot vectorise more."""
    # Flat and without a sign, so that the compiler need not think of indices counted from the end.
    points, normals, visible = model.points.flat, model.normals.flat, model.visible
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    fx, fy, cx, cy = region.fx, region.fy, region.cx, region.cy
    one, two, start = np.uint64(1), np.uint64(2), np.uint64(first)
    facing, u, v, depth = scratch[0], scratch[1], scratch[2], scratch[3]
    m0, m1, m2 = scratch[4], scratch[5], scratch[6]
    for k in range(np.uint64(count)):
        i = np.uint64(3 * visible[start + k])
        u[k], v[k], depth[k] = points[i], points[i + one], points[i + two]
        m0[k], m1[k], m2[k] = normals[i], normals[i + one], normals[i + two]
    for k in range(count):
        s0, s1, s2 = u[k], v[k], depth[k]
        u[k] = r00 * s0 + r01 * s1 + r02 * s2 + t0
        v[k] = r10 * s0 + r11 * s1 + r12 * s2 + t1
        depth[k] = r20 * s0 + r21 * s1 + r22 * s2 + t2
    for k in range(count):
        n0, n1, n2 = m0[k], m1[k], m2[k]
        m0[k] = r00 * n0 + r01 * n1 + r02 * n2
        m1[k] = r10 * n0 + r11 * n1 + r12 * n2
        m2[k] = r20 * n0 + r21 * n1 + r22 * n2
    for k in range(count):
        x, y, z = u[k], v[k], depth[k]
        cosine = -(m0[k] * x + m1[k] * y + m2[k] * z) / np.sqrt(x * x + y * y + z * z)
        facing[k] = cosine if z >= NEAREST_M else 0.0
    for k in range(count):
        inverse = 1.0 / depth[k]
        u[k] = u[k] * inverse * fx + cx
        v[k] = v[k] * inverse * fy + cy


@jit_dividing
def _look_up(region: RegionArrays, count: int, scratch: Float64) -> None:
    """Read at the samples: depth, belief, whether the colour is known, and whether they are in the image at
    all."""
    height, width = region.depth.shape
    depth, belief, saturated = region.depth.flat, region.belief.flat, region.saturated.flat
    u, v, place, inside = scratch[1], scratch[2], scratch[20], scratch[11]
    observed, believed, clear = scratch[8], scratch[9], scratch[10]
    right, bottom = width - 0.5, height - 0.5
    for k in range(count):
        within = (u[k] >= -0.5) & (v[k] >= -0.5) & (u[k] < right) & (v[k] < bottom)
        pixel = np.floor(v[k] + 0.5) * width + np.floor(u[k] + 0.5)
        inside[k] = 1.0 if within else 0.0
        place[k] = pixel if within else 0.0
    for k in range(count):
        p = np.uint64(np.int64(place[k]))
        observed[k], believed[k] = depth[p], belief[p]
        clear[k] = 0.0 if saturated[p] else 1.0


@jit_dividing
def _compare(
    region: RegionArrays, count: int, tolerance: float, least: float, scratch: Float64, out: Float64
) -> tuple[float, float]:
    """Compare the samples with depth: writes their weights in colour, and the terms that depth decides.
    Returns the sums of all samples' facing and of these weights. least: weight of depth without belief."""
    facings, u, v, depth = scratch[0], scratch[1], scratch[2], scratch[3]
    weight, observed, believed, clear, inside = scratch[7], scratch[8], scratch[9], scratch[10], scratch[11]
    each, of_blind = 1.0 / tolerance, region.blind
    fit, near, violation, occluded, total, color_weight = 0.0, 0.0, 0.0, 0.0, 1e-9, 0.0
    through, hidden, blind, outside, colored = 0.0, 0.0, 0.0, 0.0, 0.0
    left, top, right, bottom = 1e9, 1e9, -1e9, -1e9
    for k in range(count):
        facing = facings[k] if facings[k] >= GRAZING else 0.0
        total += facing
        outside += facing * (1.0 - inside[k])
        facing *= inside[k]
        z, reading, belief = depth[k], observed[k], believed[k]
        # A removed plane has negative depth: a surface that lies in it is neither violated nor confirmed by
        # it.
        in_plane = (reading < 0.0) & (abs(reading + z) * facing < tolerance)
        unread = reading == 0.0
        # Distance along the ray, projected onto the normal: slanted surfaces tolerate more.
        gap = (reading - z) * facing * each if reading >= 0.0 else FAR
        fits = facing if (abs(gap) < 1.0) & ~unread else 0.0
        unknown = facing if unread else 0.0
        behind = facing if (gap >= 1.0) & ~in_plane else 0.0
        # A reading in front occludes the object, unless it is believed to be the object itself, or the object
        # would penetrate it.
        front = facing if (gap <= -1.0) & ~unread else 0.0
        near += fits
        blind += facing if unread | in_plane else 0.0
        through += behind
        hidden += front
        violation += behind + front * IMPLAUSIBLE * (1.0 if gap > -STICKING else belief)
        occluded += front * (1.0 - belief)
        trust = least + (1.0 - least) * belief
        fit += fits * trust * (1.0 - gap * gap)
        in_color = clear[k] * (fits + of_blind * unknown)
        colored += in_color
        weight[k] = trust * in_color
        color_weight += trust * in_color
        inside[k] = fits + unknown
    # In a loop of its own: the compiler does not vectorise a minimum.
    for k in range(count):
        if inside[k] > 0.0:
            left, right = min(left, u[k]), max(right, u[k])
            top, bottom = min(top, v[k]), max(bottom, v[k])
    out[1] = fit / (near + violation + MARGIN * total)
    out[3] = violation / (near + violation + MARGIN * total)
    out[5] = occluded / total
    out[6] = near / total
    out[7] = _box_iou(left, top, right, bottom, region.bounds)
    out[8] = through / (near + through + MARGIN * total)
    out[9] = hidden / total
    out[10] = blind / total
    out[11] = outside / total
    out[16] = colored / total
    return total, color_weight


@jit_dividing
def _compacted(model: ModelArrays, first: int, count: int, scratch: Float64) -> int:
    """Move the rows of samples with a weight in colour to the front; returns the number of these samples."""
    fitting = 0
    for k in range(count):
        weight = scratch[7, k]
        scratch[4, fitting], scratch[5, fitting] = scratch[4, k], scratch[5, k]
        scratch[6, fitting], scratch[7, fitting] = scratch[6, k], weight
        scratch[20, fitting] = model.visible[first + k]
        scratch[21, fitting], scratch[22, fitting] = scratch[1, k], scratch[2, k]
        fitting += 1 if weight > 0.0 else 0
    return fitting


@jit_dividing
def _read_colors(model: ModelArrays, region: RegionArrays, count: int, scratch: Float64) -> None:
    """Read the colours of the samples that fit: of the texture, and of the image, interpolated between
    pixels."""
    height, width = region.depth.shape
    # Flat and without a sign, so that the compiler need not think of indices counted from the end.
    fine, coarse = model.colors[region.finest].flat, model.colors[region.finest + 1].flat
    colors = region.colors.flat
    scale, below = np.uint64(3 * height * width), np.uint64(3 * width)
    first, right = scale * np.uint64(region.finest), np.uint64(3)
    for k in range(count):
        uf, vf = scratch[21, k], scratch[22, k]
        u0, v0 = min(max(int(uf), 0), width - 2), min(max(int(vf), 0), height - 2)
        a, b = min(max(uf - u0, 0.0), 1.0), min(max(vf - v0, 0.0), 1.0)
        c00, c01 = np.float32((1.0 - a) * (1.0 - b)), np.float32(a * (1.0 - b))
        c10, c11 = np.float32((1.0 - a) * b), np.float32(a * b)
        i = np.uint64(3 * int(scratch[20, k]))
        p = np.uint64(3 * (v0 * width + u0)) + first
        for q in range(np.uint64(3)):
            scratch[8 + q, k] = fine[i + q]
            scratch[11 + q, k] = coarse[i + q]
        for q in range(np.uint64(3)):
            upper = c00 * colors[p + q] + c01 * colors[p + q + right]
            lower = c10 * colors[p + q + below] + c11 * colors[p + q + below + right]
            scratch[14 + q, k] = upper + lower
            wide = p + q + scale
            upper = c00 * colors[wide] + c01 * colors[wide + right]
            lower = c10 * colors[wide + below] + c11 * colors[wide + below + right]
            scratch[17 + q, k] = upper + lower


@jit_dividing
def _coverage(T: Float64, model: ModelArrays, region: RegionArrays, enough: float, scratch: Float64) -> float:
    """Coverage: share of the mask points that lie on the surface, where it faces the camera. If it cannot
    exceed `enough`, some upper bound of it that is not over `enough` is returned. scratch: 11 rows or
    more."""
    point_weights, tolerance = region.point_weights, region.tolerance
    # Flat and without a sign, so that the compiler need not think of indices counted from the end. (`ravel`
    # costs a call.)
    points_cam, points, normals = region.points_cam.flat, model.points.flat, model.normals.flat
    cells = model.nearest.flat
    o0, o1, o2, scale = model.origin[0], model.origin[1], model.origin[2], 1.0 / model.step
    d0, d1, d2 = model.nearest.shape
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    p0, p1, p2, place, given = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    s0, s1, s2, m0, m1, m2 = scratch[5], scratch[6], scratch[7], scratch[8], scratch[9], scratch[10]
    # The camera's position in object axes is -eye.
    eye0 = r00 * t0 + r10 * t1 + r20 * t2
    eye1 = r01 * t0 + r11 * t1 + r21 * t2
    eye2 = r02 * t0 + r12 * t1 + r22 * t2
    reach2, sharpness = 9.0 * tolerance * tolerance, 1.0 / (tolerance * tolerance)
    total = 1e-9
    for k in range(point_weights.shape[0]):
        total += point_weights[k]
    # If the points lose more than this in total, the coverage cannot exceed `enough`.
    spare = total * (1.0 - enough + 1e-9)
    lost = 0.0
    block = min(BLOCK, scratch.shape[1])
    for first in range(0, point_weights.shape[0], block):
        if lost > spare:
            break
        count, start = min(block, point_weights.shape[0] - first), np.uint64(first)
        for k in range(np.uint64(count)):
            i = three * (start + k)
            x, y, z = points_cam[i] - t0, points_cam[i + one] - t1, points_cam[i + two] - t2
            p0[k] = r00 * x + r10 * y + r20 * z
            p1[k] = r01 * x + r11 * y + r21 * z
            p2[k] = r02 * x + r12 * y + r22 * z
        for k in range(np.uint64(count)):
            f0, f1, f2 = (p0[k] - o0) * scale + 0.5, (p1[k] - o1) * scale + 0.5, (p2[k] - o2) * scale + 0.5
            inside = (f0 >= 0.0) & (f1 >= 0.0) & (f2 >= 0.0) & (f0 < d0) & (f1 < d1) & (f2 < d2)
            cell = np.floor(f0) * (d1 * d2) + np.floor(f1) * d2 + np.floor(f2)
            place[k] = cell if inside else 0.0
            given[k] = point_weights[start + k] if inside else 0.0
        for k in range(count):
            j = np.uint64(3 * cells[np.uint64(place[k])])
            s0[k], s1[k], s2[k] = points[j], points[j + one], points[j + two]
            m0[k], m1[k], m2[k] = normals[j], normals[j + one], normals[j + two]
        weight, kept = 0.0, 0.0
        for k in range(np.uint64(count)):
            n0, n1, n2 = m0[k], m1[k], m2[k]
            e0, e1, e2 = p0[k] - s0[k], p1[k] - s1[k], p2[k] - s2[k]
            gap = e0 * n0 + e1 * n1 + e2 * n2
            shown = n0 * (p0[k] + eye0) + n1 * (p1[k] + eye1) + n2 * (p2[k] + eye2) <= 0.0
            near = (abs(gap) < tolerance) & (e0 * e0 + e1 * e1 + e2 * e2 < reach2)
            kept += given[k] * (1.0 - gap * gap * sharpness) if shown & near else 0.0
            weight += point_weights[start + k]
        lost += weight - kept
    return float((total - lost) / total)


@jit_dividing
def _box_iou(left: float, top: float, right: float, bottom: float, bounds: Float64) -> float:
    w = min(right, bounds[2]) - max(left, bounds[0])
    h = min(bottom, bounds[3]) - max(top, bounds[1])
    if w <= 0.0 or h <= 0.0:
        return 0.0
    area = (right - left) * (bottom - top) + (bounds[2] - bounds[0]) * (bounds[3] - bounds[1])
    return float(w * h / (area - w * h))
