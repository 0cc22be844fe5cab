"""Refine a pose inside a frame: depth and texture in one Gauss-Newton loop.

The paper refines with point-to-plane ICP alone (section III-E). Depth does not fix a rotation about an axis
of symmetry or a slide along a plane face, so every step also aligns the model's colours with the image (the
residual of Lucas and Kanade, on surface samples instead of pixels). Both terms refer to the model, so nothing
drifts. The light is fitted in every iteration (`light`); samples whose colour does not fit get less weight in
depth as well; coarse averages of the texture come before fine ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64, Int32
from huepose.geometry.camera import NEAR_M, depth_noise_m
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays
from huepose.judge.open_region import SCALES_M, OpenRegion, PreparedSurface
from huepose.refine.light import fit_light
from huepose.refine.samples import (
    AGREES,
    BEHIND,
    NO_DEPTH,
    OCCLUDED,
    Samples,
    colors,
    empty_samples,
    project,
)
from huepose.refine.solver import (
    Body,
    NormalEquations,
    add_residual,
    advance,
    clear,
    information,
    motion_row,
    motion_row_cam,
    normal_equations,
    tukey,
)
from huepose.support.jit import jit, jit_dividing

COLOR_SHARE = 3.0
"""Weight of a colour residual against a depth residual, each in units of its own noise. Depth errors of real
sensors are correlated with their neighbours', so each counts less than it seems."""

COLOR_SIGMA_FLOOR = 2.5
"""Smallest noise of a colour residual, opponent units."""

LIGHTNESS_WEIGHT = 0.5
"""Weight of lightness against the other two channels: shading changes lightness, too."""

NO_DEPTH_WEIGHT = 0.3
"""Weight of colours where no depth shows whether the object is occluded."""

DISTRUST_FLOOR = 0.2
"""Smallest factor on a depth residual whose colour does not fit: the cause may be a highlight."""

OUTLINE_FLOOR = 0.1
"""Weight of samples at the outline, where colours and depth are mixed with the background's."""

INSIDE_SHARE, SCALE_SHARE = 0.25, 0.25
"""Shares of the object's thickness. Within the first share, the surface around a sample continues; a texture
averaged over more than the second mixes the object's sides."""

LIGHT_ROUNDS = 3
"""Rounds of reweighting to find the light."""

DAMPING = 2e-3
"""Damping of Levenberg and Marquardt, as a share of the information about the translation."""

START_SIGMA_M = 0.01
"""Standard deviation of a near start, metres at the object's rim."""

RESIDUALS_PER_READING = 12.0
"""This many residuals are worth one independent one: errors of neighbouring pixels are correlated."""

MIN_COLORS = 20
"""With fewer samples that have a colour, depth alone is used."""

STILL_M = 2e-5
"""A step smaller than this (metres, and metres at the object's rim) ends a level."""


@dataclass(frozen=True)
class Schedule:
    """Iterations of a refinement: the texture level (0 fine, 2 coarse), the depth gate in metres and the
    number of samples of each. Coarse levels need fewer samples.

    relaxation: factor of every step; near: the start is off by about START_SIGMA_M at the object's rim.
    Directions that neither depth nor texture fix then stay as they were, and image gradients steeper than the
    texture's are limited. From farther away such gradients do no harm and help convergence."""

    levels: tuple[int, ...]
    gates_m: tuple[float, ...]
    samples: tuple[int, ...]
    near: bool = False
    relaxation: float = 1.0

    @cached_property
    def arrays(self) -> tuple[Int32, Float64, Int32]:
        """Levels, gates and samples as arrays (N,)."""
        return np.array(self.levels, np.int32), np.array(self.gates_m), np.array(self.samples, np.int32)


FULL = Schedule(
    (2, 2, 1, 1, 1, 0, 0, 0),
    (0.025, 0.02, 0.015, 0.012, 0.01, 0.01, 0.008, 0.008),
    (150, 150, 300, 300, 300, 600, 600, 600),
)
"""From a start within some centimetres."""

NEAR = Schedule(
    (2, 1, 1, 0, 0),
    (0.025, 0.012, 0.01, 0.01, 0.008),
    (150, 300, 300, 600, 600),
    near=True,
    relaxation=1.4,
)
"""From where the object is expected. A plain step covers about half of the error that the texture shows and
all that depth shows, since light and weights are fixed in it; 1.4 times it leaves less than half of both."""

QUICK = Schedule((2, 2, 2), (0.04, 0.03, 0.025), (100,) * 3)
COARSE = Schedule((2, 2, 2, 2, 2), (0.03, 0.025, 0.02, 0.02, 0.015), (200,) * 5)
"""From far off, for hypotheses that are ranked afterwards: QUICK for many, COARSE for those that are left."""

FINE = Schedule(
    (1, 1, 1, 0, 0, 0, 0),
    (0.012, 0.012, 0.012, 0.01, 0.01, 0.008, 0.008),
    (400,) * 7,
)
"""For the hypotheses that are left after COARSE."""


class _Settings(NamedTuple):
    """A schedule at a distance. held: prior information of a near start, 0 for others."""

    levels: Int32
    gates_m: Float64
    samples: Int32
    depth_sigma_m: float
    px_per_m: float
    thickness_m: float
    held: float
    relaxation: float
    body: Body


@dataclass(frozen=True, eq=False)
class Refined:
    """T_cam_obj (4, 4) and its information (6, 6) with respect to `se3.perturb`, as if the residuals' errors
    were independent (`tracking.uncertainty` corrects for that)."""

    T_cam_obj: Float64
    information: Float64


def refine(
    surface: PreparedSurface, region: OpenRegion, T_cam_obj: Float, schedule: Schedule = FULL
) -> Refined:
    """Improve a pose whose object lies in `region`."""
    T = np.array(T_cam_obj, np.float64, order="C")
    settings = _settings(schedule, surface, float(surface.centre_cam(T)[2]), region.camera.fx)
    A = np.zeros((6, 6))
    _refine(T, surface.arrays, surface.steepest, region.arrays, settings, A)
    T = se3.orthonormalised(T)
    return Refined(T, information(A, T, settings.body))


def refine_all(
    surface: PreparedSurface, region: OpenRegion, poses: Float, schedule: Schedule, distance_m: float
) -> Float64:
    """Improve poses (K, 4, 4) of an object at about that distance; the improved ones (K, 4, 4)."""
    out = np.array(poses, np.float64, order="C")
    settings = _settings(schedule, surface, distance_m, region.camera.fx)
    _refine_all(out, surface.arrays, surface.steepest, region.arrays, settings)
    return out


def _settings(schedule: Schedule, surface: PreparedSurface, distance_m: float, fx: float) -> _Settings:
    """The settings of a schedule at a distance."""
    sigma_m, px_per_m = depth_noise_m(distance_m), fx / max(distance_m, NEAR_M)
    held = RESIDUALS_PER_READING / START_SIGMA_M**2 if schedule.near else 0.0
    body = Body(surface.arrays.centre, surface.radius_m)
    return _Settings(
        *schedule.arrays, sigma_m, px_per_m, surface.thickness_m, held, schedule.relaxation, body
    )


@jit
def _refine_all(
    poses: Float64, surface: ModelArrays, steepest: Float32, region: RegionArrays, settings: _Settings
) -> None:
    """Move poses in place."""
    A = np.empty((6, 6))
    for k in range(poses.shape[0]):
        _refine(poses[k], surface, steepest, region, settings, A)


@jit
def _refine(
    T: Float64,
    surface: ModelArrays,
    steepest: Float32,
    region: RegionArrays,
    settings: _Settings,
    known: Float64,
) -> int:
    """Move T in place; the last normal equations are left in `known`. Returns the iterations done."""
    levels, gates, body, thickness_m = settings.levels, settings.gates_m, settings.body, settings.thickness_m
    coarsest = 1
    for scale in range(2, len(SCALES_M)):
        if SCALES_M[scale] <= SCALE_SHARE * thickness_m:
            coarsest = scale
    limit = settings.samples.max()
    samples = empty_samples(limit)
    weight, color_weight, trust = np.empty(limit), np.empty(limit), np.empty(limit)
    color, gradient, residual = np.empty((limit, 3)), np.empty((limit, 3, 2)), np.empty((limit, 3))
    correlation, rms, share = np.zeros(3), np.zeros(3), np.zeros(3)
    equations = normal_equations(6)
    A = equations.A
    moved = np.zeros(6)
    done = 0
    still_at = -1
    for iteration in range(levels.shape[0]):
        level, gate = min(levels[iteration], coarsest), max(gates[iteration], 3.5 * settings.depth_sigma_m)
        if level == still_at and iteration < levels.shape[0] - 1:
            continue
        # On a thin object a neighbour further off than INSIDE_SHARE of it would always lie beside it.
        inside_m = min(1.5 * SCALES_M[level], INSIDE_SHARE * thickness_m)
        inside_px = max(1, int(np.rint(inside_m * settings.px_per_m)))
        n = project(T, surface, region, settings.samples[iteration], gate, inside_px, samples)
        for k in range(n):
            facing = min(1.0, 2.0 * samples.cosine[k])
            weight[k] = facing * (OUTLINE_FLOOR + (1.0 - OUTLINE_FLOOR) * samples.inside[k])
            color_weight[k] = weight[k] if samples.kind[k] == AGREES else NO_DEPTH_WEIGHT * facing
        clear(equations)
        left = colors(n, samples, region, level, color, gradient, color_weight)
        if left >= MIN_COLORS:
            if settings.held > 0.0:
                _limit_gradients(n, samples, steepest[level], region, gradient, color_weight)
            fit_light(
                n, samples, color_weight, surface.colors[level], color, LIGHT_ROUNDS, residual, trust,
                correlation, rms,
            )  # fmt: skip
            for c in range(3):
                # Where texture and image are not correlated, their difference says nothing.
                share[c] = (
                    COLOR_SHARE * (0.1 + max(correlation[c], 0.0)) * (LIGHTNESS_WEIGHT if c == 0 else 1.0)
                )
                share[c] /= max(COLOR_SIGMA_FLOOR, rms[c]) ** 2
            for k in range(n):
                if color_weight[k] > 0.0:
                    color_weight[k] *= trust[k]
                    weight[k] *= DISTRUST_FLOOR + (1.0 - DISTRUST_FLOOR) * trust[k]
            _add_color(
                T, n, samples, surface, color_weight, gradient, residual, region, body, share, equations
            )
        variance = max(settings.depth_sigma_m**2, _depth_variance(n, samples, weight, gate))
        _add_depth(n, samples, surface, weight, gate, 1.0 / variance, body, equations)
        known[:] = A
        # In proportion to the information, so that colours alone move a pose as freely as depth does.
        damping = DAMPING * (A[0, 0] + A[1, 1] + A[2, 2])
        for i in range(6):
            equations.b[i] -= settings.held * moved[i]
        largest = advance(T, equations, body, damping + settings.held, settings.relaxation)
        if largest < 0.0:
            break
        moved += equations.step
        done += 1
        still_at = level if largest < STILL_M else -1
    return done


@jit_dividing
def _limit_gradients(
    n: int, samples: Samples, steepest: Float32, region: RegionArrays, gradient: Float64, weight: Float64
) -> None:
    """Limit gradients (n, 3, 2) of the image to the steepest slope of the texture there (N, 3). The rest is
    shading, a shadow's edge or noise, which do not move with the object."""
    for k in range(n):
        if weight[k] <= 0.0:
            continue
        # The image is averaged over the same length, so a slanted surface is not steeper in it.
        m_per_px = samples.points[k, 2] / (0.5 * (region.fx + region.fy))
        for c in range(3):
            right, down = gradient[k, c, 0], gradient[k, c, 1]
            most, seen = steepest[samples.which[k], c] * m_per_px, np.sqrt(right * right + down * down)
            if seen > most:
                gradient[k, c, 0] *= most / seen
                gradient[k, c, 1] *= most / seen


@jit_dividing
def _depth_variance(n: int, samples: Samples, weight: Float64, gate: float) -> float:
    """Weighted mean square of the offsets within the gate."""
    total, square = 1e-12, 0.0
    for k in range(n):
        e = samples.offset[k]
        if samples.kind[k] == AGREES or (
            (samples.kind[k] == BEHIND or samples.kind[k] == OCCLUDED) and abs(e) < gate
        ):
            w = weight[k] * tukey((e / gate) ** 2)
            total += w
            square += w * e * e
    return square / total


@jit_dividing
def _add_depth(
    n: int,
    samples: Samples,
    surface: ModelArrays,
    weight: Float64,
    gate: float,
    sharpness: float,
    body: Body,
    equations: NormalEquations,
) -> None:
    """Add the distances of the readings from the samples' planes; sharpness: 1 / variance of one."""
    for k in range(n):
        e = samples.offset[k]
        if samples.kind[k] >= NO_DEPTH or abs(e) >= gate:
            continue
        p, m = surface.points[samples.which[k]], surface.normals[samples.which[k]]
        m0, m1, m2 = np.float64(m[0]), np.float64(m[1]), np.float64(m[2])
        row = motion_row(p[0], p[1], p[2], m0, m1, m2, body)
        add_residual(equations, weight[k] * tukey((e / gate) ** 2) * sharpness, e, row)


@jit_dividing
def _add_color(
    T: Float64,
    n: int,
    samples: Samples,
    surface: ModelArrays,
    weight: Float64,
    gradient: Float64,
    residual: Float64,
    region: RegionArrays,
    body: Body,
    sharpness: Float64,
    equations: NormalEquations,
) -> None:
    """Add the photometric residuals: lit texture less image at the projected sample.

    The rows of a sample's channels are combinations of two rows: for a move of one pixel right, and of one
    down."""
    right, down, by_right, by_down = np.empty((6, n)), np.empty((6, n)), np.empty((6, n)), np.empty((6, n))
    pull_right, pull_down = np.empty(n), np.empty(n)
    m = 0
    for k in range(n):
        if weight[k] <= 0.0:
            continue
        x, y, inverse = samples.points[k, 0], samples.points[k, 1], 1.0 / samples.points[k, 2]
        p = surface.points[samples.which[k]]
        fx, fy = region.fx * inverse, region.fy * inverse
        along_u = motion_row_cam(T, p[0], p[1], p[2], fx, 0.0, -fx * x * inverse, body)
        along_v = motion_row_cam(T, p[0], p[1], p[2], 0.0, fy, -fy * y * inverse, body)
        uu, uv, vv, pull_right[m], pull_down[m] = 0.0, 0.0, 0.0, 0.0, 0.0
        for c in range(3):
            w, gu, gv = weight[k] * sharpness[c], gradient[k, c, 0], gradient[k, c, 1]
            uu += w * gu * gu
            uv += w * gu * gv
            vv += w * gv * gv
            pull_right[m] -= w * gu * residual[k, c]
            pull_down[m] -= w * gv * residual[k, c]
        for i in range(6):
            right[i, m], down[i, m] = along_u[i], along_v[i]
            by_right[i, m], by_down[i, m] = (
                uu * along_u[i] + uv * along_v[i],
                uv * along_u[i] + vv * along_v[i],
            )
        m += 1
    for i in range(6):
        pull = 0.0
        for k in range(m):
            pull += right[i, k] * pull_right[k] + down[i, k] * pull_down[k]
        equations.b[i] += pull
        for j in range(i + 1):
            known = 0.0
            for k in range(m):
                known += by_right[i, k] * right[j, k] + by_down[i, k] * down[j, k]
            equations.A[i, j] += known
