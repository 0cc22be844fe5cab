"""What improves a pose inside a frame: depth and texture in one Gauss-Newton loop.

The paper refines with point-to-plane ICP alone (section III-E). Depth cannot see a rotation about an axis of
symmetry or a slide along a flat face, so here every step also aligns the model's own colours with the image
(Lucas and Kanade's residual, on surface samples instead of pixels). Both terms are anchored to the model, so
nothing drifts; the light is fitted anew in every iteration (`light`), samples whose colour does not belong to
the object lose their say in depth as well, and coarse averages of the texture come before fine ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64, Int32
from huepose.geometry.depth_noise import depth_noise_m
from huepose.geometry.kernels import rotation_exp_into, solve_symmetric
from huepose.judge.arrays import ModelArrays, RegionArrays
from huepose.judge.open_region import SCALES_M, OpenRegion
from huepose.judge.surface import PreparedSurface
from huepose.refine.light import fit_light
from huepose.refine.samples import AGREES, BEHIND, HIDDEN, Samples, colors, empty_samples, project
from huepose.support.jit import jit

COLOR_SHARE = 3.0
"""Weight of a colour residual against a depth residual, each in units of its own noise. Depth errors of real
sensors agree with their neighbours', so each of them is worth less than it seems."""

COLOR_SIGMA_FLOOR = 2.5
"""Opponent units."""

LIGHTNESS_WEIGHT = 0.5
NO_DEPTH_WEIGHT = 0.3
"""Of colours where there is no depth to say whether the object is in front."""

DISTRUST_FLOOR = 0.2
"""Smallest factor of a depth residual whose colour does not fit: highlights are not the object's fault."""

OUTLINE_FLOOR = 0.1
"""Weight of samples at the outline, where colours and depth are mixed with the background's."""

INSIDE_SHARE, SCALE_SHARE = 0.25, 0.25
"""Of the object's thickness: within the first of a sample its own surface goes on; a texture averaged over
more than the second mixes its sides."""

LIGHT_ROUNDS = 3
DAMPING = 2e-3
"""Of Levenberg and Marquardt, as a share of the information about the translation."""

MIN_COLORS = 20
STILL_M = 2e-5
"""A step smaller than this (metres, and metres at the object's rim) ends a level."""


@dataclass(frozen=True)
class Schedule:
    """Iterations of a refinement: the texture level (0 fine, 2 coarse) and the depth gate in metres of each,
    and the number of samples."""

    levels: tuple[int, ...]
    gates_m: tuple[float, ...]
    samples: int


FULL = Schedule(
    (2, 2, 1, 1, 1, 0, 0, 0),
    (0.025, 0.02, 0.015, 0.012, 0.01, 0.01, 0.008, 0.008),
    600,
)
"""From a start within about a centimetre."""

QUICK = Schedule((2, 2, 2), (0.04, 0.03, 0.025), 100)
COARSE = Schedule((2, 2, 2, 2, 2), (0.03, 0.025, 0.02, 0.02, 0.015), 200)
"""From far off, for hypotheses that are sorted afterwards: of many, and of those that are left."""

FINE = Schedule((1, 1, 1, 0, 0, 0, 0), (0.012, 0.012, 0.012, 0.01, 0.01, 0.008, 0.008), 400)
"""What is left after COARSE."""


class _Settings(NamedTuple):
    """A schedule at a distance. reaches_px: of each scale, how far away the neighbours are that tell whether
    a sample lies inside the object."""

    levels: Int32
    gates_m: Float64
    reaches_px: Int32
    samples: int
    depth_sigma_m: float
    radius_m: float


@dataclass(frozen=True, eq=False)
class Refined:
    """T_cam_obj (4, 4) and information (6, 6) of it with respect to `se3.perturb`, as if the residuals'
    errors were independent (`uncertainty` says what that is worth); iterations done."""

    T_cam_obj: Float64
    information: Float64
    iterations: int


def refine(
    surface: PreparedSurface, region: OpenRegion, T_cam_obj: Float, schedule: Schedule = FULL
) -> Refined:
    """Improve a pose whose object lies in `region`."""
    T = np.array(T_cam_obj, np.float64, order="C")
    settings = _settings(schedule, surface, float(surface.centre_cam(T)[2]), region.camera.fx)
    A = np.zeros((6, 6))
    done = _refine(T, surface.arrays, region.arrays, settings, A)
    T = se3.orthonormalised(T)
    return Refined(T, _about_origin(A, surface, T), int(done))


def refine_all(
    surface: PreparedSurface, region: OpenRegion, poses: Float, schedule: Schedule, distance_m: float
) -> Float64:
    """Improve poses (K, 4, 4) of an object at about that distance; the improved ones (K, 4, 4)."""
    out = np.array(poses, np.float64, order="C")
    settings = _settings(schedule, surface, distance_m, region.camera.fx)
    _refine_all(out, surface.arrays, region.arrays, settings)
    return out


def _settings(schedule: Schedule, surface: PreparedSurface, distance_m: float, fx: float) -> _Settings:
    """What a schedule means at a distance."""
    sigma = depth_noise_m(distance_m)
    gates = np.maximum(np.array(schedule.gates_m), 3.5 * sigma)
    px_per_m = fx / max(distance_m, 0.05)
    # On a thin object a neighbour further off than this would always lie beside it.
    widest = INSIDE_SHARE * surface.thickness_m
    reaches = np.array([max(1, round(min(1.5 * s, widest) * px_per_m)) for s in SCALES_M], np.int32)
    coarsest = max(1, sum(s <= SCALE_SHARE * surface.thickness_m for s in SCALES_M) - 1)
    levels = np.minimum(np.array(schedule.levels, np.int32), np.int32(coarsest))
    return _Settings(levels, gates, reaches, schedule.samples, sigma, surface.radius_m)


def _about_origin(A: Float64, surface: PreparedSurface, T: Float64) -> Float64:
    """Information about [translation, radius * rotation about the centre] as information about
    `se3.perturb`."""
    lever = T[:3, :3] @ surface.arrays.centre
    to_step = np.eye(6)
    # Turning about the origin also carries the centre along.
    to_step[:3, 3:] = -se3.hat(lever)
    to_step[3:, 3:] *= surface.radius_m
    return np.asarray(to_step.T @ A @ to_step)


@jit
def _refine_all(poses: Float64, surface: ModelArrays, region: RegionArrays, settings: _Settings) -> None:
    """Move poses in place."""
    information = np.empty((6, 6))
    for k in range(poses.shape[0]):
        _refine(poses[k], surface, region, settings, information)


@jit
def _refine(
    T: Float64,
    surface: ModelArrays,
    region: RegionArrays,
    settings: _Settings,
    information: Float64,
) -> int:
    """Move T in place; the last normal equations are left in `information`. Returns the iterations done."""
    levels, gates, limit, radius = settings.levels, settings.gates_m, settings.samples, settings.radius_m
    samples = empty_samples(limit)
    weight, color_weight, trust = np.empty(limit), np.empty(limit), np.empty(limit)
    color, gradient, residual = np.empty((limit, 3)), np.empty((limit, 3, 2)), np.empty((limit, 3))
    correlation, rms, share = np.zeros(3), np.zeros(3), np.zeros(3)
    A, b, x = np.empty((6, 6)), np.empty(6), np.empty(6)
    D, centre = np.empty((3, 3)), np.empty(3)
    done = 0
    still_at = -1
    for iteration in range(levels.shape[0]):
        level, gate = levels[iteration], gates[iteration]
        if level == still_at and iteration < levels.shape[0] - 1:
            continue
        for i in range(3):
            centre[i] = T[i, 3]
            for j in range(3):
                centre[i] += T[i, j] * surface.centre[j]
        n = project(T, surface, region, limit, gate, settings.reaches_px[level], samples)
        for k in range(n):
            facing = min(1.0, 2.0 * samples.cosine[k])
            weight[k] = facing * (OUTLINE_FLOOR + (1.0 - OUTLINE_FLOOR) * samples.inside[k])
            color_weight[k] = weight[k] if samples.kind[k] == AGREES else NO_DEPTH_WEIGHT * facing
        A[:] = 0.0
        b[:] = 0.0
        left = colors(n, samples, region, level, color, gradient, color_weight)
        if left >= MIN_COLORS:
            fit_light(
                n, samples, color_weight, surface.colors[level], color, LIGHT_ROUNDS, residual, trust,
                correlation, rms,
            )  # fmt: skip
            for c in range(3):
                # Where texture and image have nothing in common their difference says nothing.
                share[c] = (
                    COLOR_SHARE * (0.1 + max(correlation[c], 0.0)) * (LIGHTNESS_WEIGHT if c == 0 else 1.0)
                )
                share[c] /= max(COLOR_SIGMA_FLOOR, rms[c]) ** 2
            for k in range(n):
                if color_weight[k] > 0.0:
                    color_weight[k] *= trust[k]
                    weight[k] *= DISTRUST_FLOOR + (1.0 - DISTRUST_FLOOR) * trust[k]
            _add_color(n, samples, color_weight, gradient, residual, region, centre, radius, share, A, b)
        variance = max(settings.depth_sigma_m**2, _depth_variance(n, samples, weight, gate))
        _add_depth(n, samples, weight, gate, 1.0 / variance, centre, radius, A, b)
        for i in range(6):
            for j in range(i):
                A[j, i] = A[i, j]
        information[:] = A
        # In proportion to what is known, so that colours alone move a pose as freely as depth does.
        damping = DAMPING * (A[0, 0] + A[1, 1] + A[2, 2]) + 1.0
        for i in range(6):
            A[i, i] += damping
        if not solve_symmetric(A, b, x):
            break
        _move(T, x, surface.centre, radius, centre, D)
        done += 1
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(x[i]))
        still_at = level if largest < STILL_M else -1
    return done


@jit
def _depth_variance(n: int, samples: Samples, weight: Float64, gate: float) -> float:
    """Weighted mean square of the offsets within the gate."""
    total, square = 1e-12, 0.0
    for k in range(n):
        e = samples.offset[k]
        if samples.kind[k] == AGREES or (
            (samples.kind[k] == BEHIND or samples.kind[k] == HIDDEN) and abs(e) < gate
        ):
            w = weight[k] * (1.0 - (e / gate) ** 2) ** 2
            total += w
            square += w * e * e
    return square / total


@jit
def _add_depth(
    n: int,
    samples: Samples,
    weight: Float64,
    gate: float,
    information: float,
    centre: Float64,
    radius: float,
    A: Float64,
    b: Float64,
) -> None:
    """Add point-to-plane residuals (Tukey's biweight) to the lower triangle of the normal equations of the
    step [translation, radius * rotation about the centre] of the object, camera axes."""
    J = np.empty(6)
    for k in range(n):
        e = samples.offset[k]
        if samples.kind[k] >= 3 or abs(e) >= gate:
            continue
        w = weight[k] * (1.0 - (e / gate) ** 2) ** 2 * information
        p0 = (samples.points[k, 0] - centre[0]) / radius
        p1 = (samples.points[k, 1] - centre[1]) / radius
        p2 = (samples.points[k, 2] - centre[2]) / radius
        J[0], J[1], J[2] = samples.normals[k, 0], samples.normals[k, 1], samples.normals[k, 2]
        J[3], J[4], J[5] = p1 * J[2] - p2 * J[1], p2 * J[0] - p0 * J[2], p0 * J[1] - p1 * J[0]
        for i in range(6):
            b[i] += w * J[i] * e
            for j in range(i + 1):
                A[i, j] += w * J[i] * J[j]


@jit
def _add_color(
    n: int,
    samples: Samples,
    weight: Float64,
    gradient: Float64,
    residual: Float64,
    region: RegionArrays,
    centre: Float64,
    radius: float,
    information: Float64,
    A: Float64,
    b: Float64,
) -> None:
    """Add the photometric residuals, image at the projected sample minus lit texture, to the same
    equations."""
    J = np.empty(6)
    for k in range(n):
        if weight[k] <= 0.0:
            continue
        x, y, inv_z = samples.points[k, 0], samples.points[k, 1], 1.0 / samples.points[k, 2]
        p0, p1 = (x - centre[0]) / radius, (y - centre[1]) / radius
        p2 = (samples.points[k, 2] - centre[2]) / radius
        for c in range(3):
            J[0] = gradient[k, c, 0] * region.fx * inv_z
            J[1] = gradient[k, c, 1] * region.fy * inv_z
            J[2] = -(J[0] * x + J[1] * y) * inv_z
            J[3], J[4], J[5] = p1 * J[2] - p2 * J[1], p2 * J[0] - p0 * J[2], p0 * J[1] - p1 * J[0]
            w = weight[k] * information[c]
            for i in range(6):
                b[i] -= w * J[i] * residual[k, c]
                for j in range(i + 1):
                    A[i, j] += w * J[i] * J[j]


@jit
def _move(T: Float64, x: Float64, middle: Float64, radius: float, centre: Float64, D: Float64) -> None:
    """Apply a step to the pose: the centre moves by x[:3], the object turns about it by x[3:] / radius."""
    rotation_exp_into(x[3] / radius, x[4] / radius, x[5] / radius, D)
    for j in range(3):
        r0, r1, r2 = T[0, j], T[1, j], T[2, j]
        for i in range(3):
            T[i, j] = D[i, 0] * r0 + D[i, 1] * r1 + D[i, 2] * r2
    for i in range(3):
        T[i, 3] = centre[i] + x[i]
        for j in range(3):
            T[i, 3] -= T[i, j] * middle[j]
