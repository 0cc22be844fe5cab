"""Robust point-to-plane ICP of depth points onto a model's surface.

Correspondences come from the model's distance grid (one look-up a point, no search tree), weights are
Tukey's on the distance to the nearest sample within a gate that shrinks, points that would lie on the far
side of the object are refused, and the step is damped so that directions which the points do not fix stay
where they are (Chen and Medioni 1992 for the residual; small_gicp for the habit of saying how it went).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.kernels import rotation_exp_into, solve_symmetric
from huepose.model.types import DistanceGrid, Surface
from huepose.support.jit import jit, jit_dividing

DAMPING = 2e-3
"""Damping per point, on steps in metres: about the weight of one point in five hundred in each direction."""

GATE_SHRUNK_AFTER = 0.7
"""Share of the iterations after which the gate has its final width."""

STEP_TOLERANCE_M = 1e-5

SCRATCH_ROWS = 12


class SurfaceArrays(NamedTuple):
    """What the compiled alignment reads of a surface: its samples and their normals (S, 3), the distance grid
    (see model.types), and the centre (3,) and lever of its rotations."""

    samples: Float32
    normals: Float32
    origin: Float64
    step: float
    nearest: np.ndarray
    centre: Float64
    radius: float


def surface_arrays(surface: Surface, grid: DistanceGrid) -> SurfaceArrays:
    """Bundle a surface's arrays for the kernels."""
    step = float(grid.step)
    return SurfaceArrays(
        surface.points, surface.normals, grid.origin, step, grid.nearest, *centre_and_radius(grid)
    )


@dataclass(frozen=True, eq=False)
class Alignment:
    """How an alignment went.

    T_cam_obj (4, 4); iterations done; inliers: points within the final gate; weight: sum of their Tukey
    weights; rms_m: weighted root mean square distance to the surface along its normals; information (6, 6):
    weighted J^T J of those distances with respect to `se3.perturb` (tx ty tz rx ry rz, camera axes, about the
    object's origin): divided by the variance of a distance it is the inverse covariance of the pose.
    """

    T_cam_obj: Float64
    iterations: int
    inliers: int
    weight: float
    rms_m: float
    information: Float64


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

    The gate goes linearly from `gate_start_m` to `gate_end_m`; it ends early when a step at the final gate is
    under 0.01 mm. With no points near the surface the pose comes back unchanged with zero inliers.
    """
    poses, report, normal_equations = _align_all(
        surface, grid, points_cam, np.asarray(T_cam_obj)[None], gate_start_m, gate_end_m, iterations
    )
    T = se3.orthonormalised(poses[0])
    centre, radius = centre_and_radius(grid)
    return Alignment(
        T,
        int(report[0, 0]),
        int(report[0, 1]),
        float(report[0, 2]),
        float(report[0, 3]),
        _camera_information(normal_equations[0], T, centre, radius),
    )


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
    return _align_all(surface, grid, points_cam, poses, gate_start_m, gate_end_m, iterations, reported=False)[
        0
    ]


def _align_all(
    surface: Surface,
    grid: DistanceGrid,
    points_cam: Float,
    poses: Float,
    gate_start_m: float,
    gate_end_m: float,
    iterations: int,
    reported: bool = True,
) -> tuple[Float64, Float64, Float64]:
    out = np.array(poses, dtype=np.float64)
    report = np.zeros((len(out), 4))
    normal_equations = np.zeros((len(out) if reported else 0, 6, 6))
    align_kernel(
        out,
        np.ascontiguousarray(points_cam, dtype=np.float64),
        surface_arrays(surface, grid),
        float(gate_start_m),
        float(gate_end_m),
        int(iterations),
        report,
        normal_equations,
    )
    return out, report, normal_equations


def centre_and_radius(grid: DistanceGrid) -> tuple[Float64, float]:
    """Where rotations turn about (the middle of the grid, so of the object), and the lever that makes radians
    comparable with metres: a third of the grid's diagonal."""
    reach = grid.step * (np.array(grid.nearest.shape) - 1) / 2.0
    return grid.origin + reach, float(np.linalg.norm(reach)) / 1.5


def _camera_information(A: Float64, T_cam_obj: Float64, centre: Float64, radius: float) -> Float64:
    """Normal equations of the kernel's steps (radius * rotation about `centre`, translation, both of the
    points in object axes) as information about `se3.perturb`."""
    R_t = T_cam_obj[:3, :3].T
    to_kernel = np.zeros((6, 6))
    to_kernel[:3, 3:] = -radius * R_t
    to_kernel[3:, :3] = -R_t
    # A rotation of the points about the origin also carries the centre along.
    to_kernel[3:, 3:] = se3.hat(centre) @ R_t
    return np.asarray(to_kernel.T @ A @ to_kernel)


@jit
def align_kernel(
    poses: Float64,
    points_cam: Float64,
    surface: SurfaceArrays,
    gate_start: float,
    gate_end: float,
    iterations: int,
    report: Float64,
    normal_equations: Float64,
) -> None:
    """Align every pose in place; report (M, 4): iterations, inliers, weight, rms, and `normal_equations` (M,
    6, 6) at the end; with none to write (0, 6, 6) only the poses are cared for."""
    A = np.empty((6, 6))
    b = np.empty(6)
    x = np.empty(6)
    D = np.empty((3, 3))
    scratch = np.empty((SCRATCH_ROWS, points_cam.shape[0]))
    for m in range(poses.shape[0]):
        T = poses[m]
        settled = False
        for iteration in range(iterations + 1):
            shrunk = min(1.0, iteration / max(1.0, iterations * GATE_SHRUNK_AFTER))
            gate = gate_start + (gate_end - gate_start) * shrunk
            last = iteration == iterations or settled
            if last and not normal_equations.shape[0]:
                break
            if last:
                gate = gate_end
            inliers, weight, square = _accumulate(T, points_cam, surface, gate, scratch, A, b)
            if last:
                report[m, 0], report[m, 1], report[m, 2] = iteration, inliers, weight
                report[m, 3] = np.sqrt(square / weight) if weight > 0.0 else 0.0
                for i in range(6):
                    for j in range(i + 1):
                        normal_equations[m, i, j] = normal_equations[m, j, i] = A[i, j]
                break
            if inliers == 0:
                # The gate only shrinks from here on.
                report[m, 0] = iteration
                break
            for i in range(6):
                A[i, i] += DAMPING * points_cam.shape[0] + 1e-12
            if not solve_symmetric(A, b, x):
                break
            _move(T, x, surface.centre, surface.radius, D)
            largest = 0.0
            for i in range(6):
                largest = max(largest, abs(x[i]))
            settled = shrunk >= 1.0 and largest < STEP_TOLERANCE_M


@jit_dividing
def _accumulate(
    T: Float64,
    points_cam: Float64,
    surface: SurfaceArrays,
    gate: float,
    scratch: Float64,
    A: Float64,
    b: Float64,
) -> tuple[int, float, float]:
    """Normal equations (lower triangle) of one linearisation; inliers, their weight, weighted squares.

    Plain passes over the rows of `scratch` (SCRATCH_ROWS, N), which the compiler does several points at a
    time; a point that counts nothing has the weight 0. Rows 0..5: first the points and the nearest samples'
    places, then the Jacobian; 6..8 normals, 9 weight, 10 distance along the normal, 11 a weighted column."""
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    count = points_cam.shape[0]
    _nearest_samples(T, points_cam, surface, scratch)
    # The camera's place in object axes is -eye.
    eye0 = r00 * t0 + r10 * t1 + r20 * t2
    eye1 = r01 * t0 + r11 * t1 + r21 * t2
    eye2 = r02 * t0 + r12 * t1 + r22 * t2
    c0, c1, c2 = surface.centre[0], surface.centre[1], surface.centre[2]
    lever, in_gate2 = 1.0 / surface.radius, 1.0 / (gate * gate)
    inliers, weight, square = 0.0, 0.0, 0.0
    for k in range(count):
        q0, q1, q2 = scratch[0, k], scratch[1, k], scratch[2, k]
        n0, n1, n2 = scratch[6, k], scratch[7, k], scratch[8, k]
        e0, e1, e2 = q0 - scratch[3, k], q1 - scratch[4, k], q2 - scratch[5, k]
        share = (e0 * e0 + e1 * e1 + e2 * e2) * in_gate2
        near = share < 1.0 and n0 * (q0 + eye0) + n1 * (q1 + eye1) + n2 * (q2 + eye2) <= 0.0
        w = (1.0 - share) ** 2 if near else 0.0
        r = n0 * e0 + n1 * e1 + n2 * e2
        q0, q1, q2 = (q0 - c0) * lever, (q1 - c1) * lever, (q2 - c2) * lever
        scratch[0, k] = q1 * n2 - q2 * n1
        scratch[1, k] = q2 * n0 - q0 * n2
        scratch[2, k] = q0 * n1 - q1 * n0
        scratch[3, k] = n0
        scratch[4, k] = n1
        scratch[5, k] = n2
        scratch[9, k] = w
        scratch[10, k] = r
        inliers += 1.0 if near else 0.0
        weight += w
        square += w * r * r
    for a in range(6):
        along = 0.0
        for k in range(count):
            weighted = scratch[9, k] * scratch[a, k]
            scratch[11, k] = weighted
            along -= weighted * scratch[10, k]
        b[a] = along
        for c in range(0, a + 1, 2):
            # Two sums at a time: each reading of the weighted column serves both.
            second = min(c + 1, a)
            one, other = 0.0, 0.0
            for k in range(count):
                one += scratch[11, k] * scratch[c, k]
                other += scratch[11, k] * scratch[second, k]
            A[a, c], A[a, second] = one, other
    return int(inliers), weight, square


@jit_dividing
def _nearest_samples(T: Float64, points_cam: Float64, surface: SurfaceArrays, scratch: Float64) -> None:
    """Of points (N, 3) seen from the pose: scratch rows 0..2 their places in object axes, 3..5 and 6..8 those
    of the nearest samples and their normals."""
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    # Flat and without a sign, so that the compiler need not think of indices counted from the end.
    samples, normals, cells = surface.samples.ravel(), surface.normals.ravel(), surface.nearest.ravel()
    o0, o1, o2, step = surface.origin[0], surface.origin[1], surface.origin[2], surface.step
    d0, d1, d2 = surface.nearest.shape
    for k in range(points_cam.shape[0]):
        x, y, z = points_cam[k, 0] - t0, points_cam[k, 1] - t1, points_cam[k, 2] - t2
        q0 = r00 * x + r10 * y + r20 * z
        q1 = r01 * x + r11 * y + r21 * z
        q2 = r02 * x + r12 * y + r22 * z
        scratch[0, k], scratch[1, k], scratch[2, k] = q0, q1, q2
        # Outside the grid the nearest border cell answers: far points are refused by the gate.
        a0 = int(min(max((q0 - o0) / step + 0.5, 0.0), d0 - 1.0))
        a1 = int(min(max((q1 - o1) / step + 0.5, 0.0), d1 - 1.0))
        a2 = int(min(max((q2 - o2) / step + 0.5, 0.0), d2 - 1.0))
        scratch[6, k] = (a0 * d1 + a1) * d2 + a2
    one, two = np.uint64(1), np.uint64(2)
    for k in range(points_cam.shape[0]):
        j = np.uint64(3 * cells[np.uint64(scratch[6, k])])
        scratch[3, k], scratch[4, k], scratch[5, k] = samples[j], samples[j + one], samples[j + two]
        scratch[6, k], scratch[7, k], scratch[8, k] = normals[j], normals[j + one], normals[j + two]


@jit
def _move(T: Float64, x: Float64, centre: Float64, radius: float, D: Float64) -> None:
    """Undo on the pose the step that the points should make in object axes: rotation x[:3] / radius about
    `centre`, then translation x[3:]."""
    rotation_exp_into(-x[0] / radius, -x[1] / radius, -x[2] / radius, D)
    # D is the inverse rotation: points go to D^T (q - c) + c + v, so the pose gets R D, and c - D (c + v).
    s0, s1, s2 = centre[0] + x[3], centre[1] + x[4], centre[2] + x[5]
    o0 = centre[0] - D[0, 0] * s0 - D[0, 1] * s1 - D[0, 2] * s2
    o1 = centre[1] - D[1, 0] * s0 - D[1, 1] * s1 - D[1, 2] * s2
    o2 = centre[2] - D[2, 0] * s0 - D[2, 1] * s1 - D[2, 2] * s2
    for i in range(3):
        a, b, c = T[i, 0], T[i, 1], T[i, 2]
        T[i, 3] += a * o0 + b * o1 + c * o2
        T[i, 0] = a * D[0, 0] + b * D[1, 0] + c * D[2, 0]
        T[i, 1] = a * D[0, 1] + b * D[1, 1] + c * D[2, 1]
        T[i, 2] = a * D[0, 2] + b * D[1, 2] + c * D[2, 2]
