"""Factor: scene points onto the model's surface, along its normals (Chen and Medioni 1992).

Correspondences come from the model's distance grid (one look-up a point, no search tree). Weights are Tukey's
on the distance to the nearest sample; points that would lie on the far side of the object are rejected.
`align` and `align_many` iterate this factor alone, with a gate that shrinks, and a damping that keeps the
pose in directions that the points do not fix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.model.types import DistanceGrid, Surface
from huepose.refine.solver import Body, NormalEquations, advance, clear, information, normal_equations, tukey
from huepose.support.jit import jit, jit_dividing
from huepose.support.kept import once_for_each

DAMPING = 2e-3
"""Damping per point, on steps in metres: about the weight of one point in five hundred in each direction."""

GATE_SHRUNK_AFTER = 0.7
"""Share of the iterations after which the gate has its final width."""

STEP_TOLERANCE_M = 1e-5  # a step that moves no point by more has converged

SCRATCH_ROWS = 12
"""Rows of the scratch array, see `add_point_to_plane`."""


class SurfaceArrays(NamedTuple):
    """What the factor reads of a model: samples of its surface and their normals (S, 3), object axes, and the
    distance grid (see model.types)."""

    samples: Float32
    normals: Float32
    origin: Float64
    step: float
    nearest: np.ndarray


class ScenePoints(NamedTuple):
    """points_cam (N, 3) metres, camera axes; weights (N,)."""

    points_cam: Float64
    weights: Float64


class Gates(NamedTuple):
    """How far from the surface a point may be, metres: from `start` linearly to `end` over the iterations."""

    start: float
    end: float
    iterations: int


class Reports(NamedTuple):
    """Results of `align_kernel` for M poses. summary (M, 4): iterations, inliers, weight, rms; A (M, 6, 6):
    normal equations at the end (lower triangles). Without rows if only the poses are needed."""

    summary: Float64
    A: Float64


NO_REPORTS = Reports(np.zeros((0, 4)), np.zeros((0, 6, 6)))
"""For callers that need only the poses."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of an alignment.

    T_cam_obj (4, 4); iterations done; inliers: points within the final gate; weight: sum of their Tukey
    weights; rms_m: weighted root mean square distance to the surface along its normals; information (6, 6):
    of those distances about `se3.perturb` (tx ty tz rx ry rz, camera axes, about the object's origin):
    divided by the variance of a distance it is the inverse covariance of the pose.
    """

    T_cam_obj: Float64
    iterations: int
    inliers: int
    weight: float
    rms_m: float
    information: Float64


def surface_arrays(surface: Surface, grid: DistanceGrid) -> SurfaceArrays:
    """Bundle a surface's arrays for the kernels."""
    return SurfaceArrays(surface.points, surface.normals, grid.origin, float(grid.step), grid.nearest)


@once_for_each
def grid_body(grid: DistanceGrid) -> Body:
    """The object's body for steps: its centre is the grid's, its radius a third of the grid's diagonal."""
    reach = grid.step * (np.array(grid.nearest.shape) - 1) / 2.0
    return Body(grid.origin + reach, float(np.linalg.norm(reach)) / 1.5)


def align(
    surface: Surface,
    grid: DistanceGrid,
    points_cam: Float,
    T_cam_obj: Float,
    gate_start_m: float,
    gate_end_m: float,
    iterations: int,
) -> Alignment:
    """Move the object so that the depth points (N, 3), camera axes, metres, lie on its surface.

    The gate goes linearly from `gate_start_m` to `gate_end_m`; the iteration ends early when a step at the
    final gate is under 0.01 mm. With no points near the surface the pose comes back unchanged with zero
    inliers.
    """
    poses, reports = np.array(T_cam_obj, np.float64)[None], Reports(np.zeros((1, 4)), np.zeros((1, 6, 6)))
    _align_all(surface, grid, points_cam, poses, Gates(gate_start_m, gate_end_m, iterations), reports)
    T = se3.orthonormalised(poses[0])
    done, inliers, weight, rms = (float(x) for x in reports.summary[0])
    known = information(reports.A[0], T, grid_body(grid))
    return Alignment(T, int(done), int(inliers), weight, rms, known)


def align_many(
    surface: Surface,
    grid: DistanceGrid,
    points_cam: Float,
    poses: Float,
    gate_start_m: float,
    gate_end_m: float,
    iterations: int,
) -> Float64:
    """`align` from each of several poses (M, 4, 4), in one compiled call; only the poses (M, 4, 4) return."""
    out = np.array(poses, dtype=np.float64)
    _align_all(surface, grid, points_cam, out, Gates(gate_start_m, gate_end_m, iterations), NO_REPORTS)
    return out


def _align_all(
    surface: Surface, grid: DistanceGrid, points_cam: Float, poses: Float64, gates: Gates, reports: Reports
) -> None:
    points = np.ascontiguousarray(points_cam, dtype=np.float64)
    scene = ScenePoints(points, np.ones(len(points)))
    gates = Gates(float(gates.start), float(gates.end), int(gates.iterations))
    align_kernel(poses, scene, surface_arrays(surface, grid), grid_body(grid), gates, reports)


@jit
def align_kernel(
    poses: Float64, scene: ScenePoints, surface: SurfaceArrays, body: Body, gates: Gates, reports: Reports
) -> None:
    """Align every pose (M, 4, 4) in place."""
    equations = normal_equations(6)
    scratch = np.empty((SCRATCH_ROWS, scene.points_cam.shape[0]))
    reported = reports.summary.shape[0] > 0
    for m in range(poses.shape[0]):
        T = poses[m]
        converged = False
        for iteration in range(gates.iterations + 1):
            shrunk = min(1.0, iteration / max(1.0, gates.iterations * GATE_SHRUNK_AFTER))
            gate = gates.start + (gates.end - gates.start) * shrunk
            last = iteration == gates.iterations or converged
            if last and not reported:
                break
            if last:
                gate = gates.end
            clear(equations)
            inliers, weight, square = add_point_to_plane(T, scene, surface, body, gate, scratch, equations)
            if last:
                summary = reports.summary[m]
                summary[0], summary[1], summary[2] = iteration, inliers, weight
                summary[3] = np.sqrt(square / weight) if weight > 0.0 else 0.0
                reports.A[m] = equations.A
                break
            if inliers == 0:
                # The gate only shrinks after this.
                if reported:
                    reports.summary[m, 0] = iteration
                break
            largest = advance(T, equations, body, DAMPING * scene.points_cam.shape[0])
            if largest < 0.0:
                break
            converged = shrunk >= 1.0 and largest < STEP_TOLERANCE_M


@jit_dividing
def add_point_to_plane(
    T: Float64,
    scene: ScenePoints,
    surface: SurfaceArrays,
    body: Body,
    gate: float,
    scratch: Float64,
    equations: NormalEquations,
) -> tuple[int, float, float]:
    """Add the residuals of all points within `gate` metres of the surface; returns their number, the sum of
    their weights, and the weighted sum of squares. With seven unknowns, the last is radius * the logarithm of
    the object's size, about its centre.

    Plain loops over the rows of `scratch` (SCRATCH_ROWS, N), which the compiler can vectorise; a rejected
    point has the weight 0. Rows 0..5: first the positions of the points and of the nearest samples, then the
    Jacobian; 6..8 normals, then 6 the Jacobian of size; 9 weight, 10 distance along the normal, 11 a weighted
    column."""
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    points_cam, point_weights = scene.points_cam, scene.weights
    count = points_cam.shape[0]
    _nearest_samples(T, points_cam, surface, scratch)
    # The camera's position in object axes is -eye.
    eye0 = r00 * t0 + r10 * t1 + r20 * t2
    eye1 = r01 * t0 + r11 * t1 + r21 * t2
    eye2 = r02 * t0 + r12 * t1 + r22 * t2
    c0, c1, c2 = body.centre[0], body.centre[1], body.centre[2]
    lever, in_gate2 = 1.0 / body.radius, 1.0 / (gate * gate)
    inliers, weight, square = 0.0, 0.0, 0.0
    for k in range(count):
        q0, q1, q2 = scratch[0, k], scratch[1, k], scratch[2, k]
        n0, n1, n2 = scratch[6, k], scratch[7, k], scratch[8, k]
        e0, e1, e2 = q0 - scratch[3, k], q1 - scratch[4, k], q2 - scratch[5, k]
        share = (e0 * e0 + e1 * e1 + e2 * e2) * in_gate2
        near = share < 1.0 and n0 * (q0 + eye0) + n1 * (q1 + eye1) + n2 * (q2 + eye2) <= 0.0
        w = point_weights[k] * tukey(share) if near else 0.0
        r = n0 * e0 + n1 * e1 + n2 * e2
        q0, q1, q2 = (q0 - c0) * lever, (q1 - c1) * lever, (q2 - c2) * lever
        scratch[0, k] = n0
        scratch[1, k] = n1
        scratch[2, k] = n2
        scratch[3, k] = q1 * n2 - q2 * n1
        scratch[4, k] = q2 * n0 - q0 * n2
        scratch[5, k] = q0 * n1 - q1 * n0
        scratch[6, k] = q0 * n0 + q1 * n1 + q2 * n2
        scratch[9, k] = w
        scratch[10, k] = r
        inliers += 1.0 if near else 0.0
        weight += w
        square += w * r * r
    A, b = equations.A, equations.b
    for a in range(A.shape[0]):
        along = 0.0
        for k in range(count):
            weighted = scratch[9, k] * scratch[a, k]
            scratch[11, k] = weighted
            along += weighted * scratch[10, k]
        b[a] += along
        for c in range(0, a + 1, 2):
            # Two sums at a time: each reading of the weighted column serves both.
            second = min(c + 1, a)
            one, other = 0.0, 0.0
            for k in range(count):
                one += scratch[11, k] * scratch[c, k]
                other += scratch[11, k] * scratch[second, k]
            A[a, c] += one
            if second > c:
                A[a, second] += other
    return int(inliers), weight, square


@jit_dividing
def _nearest_samples(T: Float64, points_cam: Float64, surface: SurfaceArrays, scratch: Float64) -> None:
    """For points (N, 3) at a pose: writes their positions in object axes to scratch rows 0..2, the positions
    and normals of the nearest samples to rows 3..5 and 6..8."""
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    # Flat and without a sign, so that the compiler need not think of indices counted from the end.
    samples, normals, cells = surface.samples.flat, surface.normals.flat, surface.nearest.flat
    o0, o1, o2, step = surface.origin[0], surface.origin[1], surface.origin[2], surface.step
    d0, d1, d2 = surface.nearest.shape
    for k in range(points_cam.shape[0]):
        x, y, z = points_cam[k, 0] - t0, points_cam[k, 1] - t1, points_cam[k, 2] - t2
        scratch[0, k] = r00 * x + r10 * y + r20 * z
        scratch[1, k] = r01 * x + r11 * y + r21 * z
        scratch[2, k] = r02 * x + r12 * y + r22 * z
    for k in range(points_cam.shape[0]):
        # Outside the grid, the nearest border cell is used; the gate rejects far points. Not as integers: not
        # every processor converts to them several numbers at once.
        a0 = np.floor(min(max((scratch[0, k] - o0) / step + 0.5, 0.0), d0 - 1.0))
        a1 = np.floor(min(max((scratch[1, k] - o1) / step + 0.5, 0.0), d1 - 1.0))
        a2 = np.floor(min(max((scratch[2, k] - o2) / step + 0.5, 0.0), d2 - 1.0))
        scratch[6, k] = (a0 * d1 + a1) * d2 + a2
    one, two = np.uint64(1), np.uint64(2)
    for k in range(points_cam.shape[0]):
        j = np.uint64(3 * cells[np.uint64(scratch[6, k])])
        scratch[3, k], scratch[4, k], scratch[5, k] = samples[j], samples[j + one], samples[j + two]
        scratch[6, k], scratch[7, k], scratch[8, k] = normals[j], normals[j + one], normals[j + two]
