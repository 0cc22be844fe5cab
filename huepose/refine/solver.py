"""The one Gauss-Newton solver: every refinement of a pose adds residuals here and takes its step from here.

A step x (6,) is a small motion of the object, along the object's own axes, about its centre (`Body`):
[translation, radius * rotation vector]. All six are metres, so one damping serves all. `move` applies it,
the shift v = x[:3] first, then the rotation w = x[3:6] / radius: T_cam_obj becomes
T_cam_obj o (p -> exp(w) (p + v - centre) + centre). A seventh unknown, where there is one, is the caller's
(`refine.final.scale_residual`).

A factor is a kernel that gives, for each of its samples, a weight, a residual and the row (6,) of the
Jacobian. The residual is the wanted minus the present value of what is compared (metres along a normal,
metres across an edge, intensity); the row is the derivative of the present value with respect to the step. So
a step minimises sum(weight * (residual - row @ x)**2), and A = sum(weight * row row^T) is the information of
the step, where weights are 1 / variance. The robust kernel (`tukey`, `cauchy`) is part of the weight:
iteratively reweighted least squares (Holland and Welsch 1977), weights taken at the present pose.

The first functions do for scalars in compiled loops, without allocation, what `se3` does for arrays.

An example, in plain Python instead of a compiled kernel: a factor of five lines that pulls the corners of a
square to their measured positions.

>>> def add_corners(T, corners, measured, body, equations):
...     for p, wanted in zip(corners, measured):
...         gap = T[:3, :3].T @ (wanted - T[:3, 3]) - p  # object axes
...         for axis, direction in enumerate(np.eye(3)):
...             add_residual(equations, 1.0, gap[axis], motion_row(*p, *direction, body))
>>> body, equations = Body(np.zeros(3), 0.05), normal_equations(6)
>>> corners, T = np.array([[0.05, 0, 0], [0, 0.05, 0], [-0.05, 0, 0], [0, -0.05, 0]]), np.eye(4)
>>> for _ in range(8):
...     clear(equations)
...     add_corners(T, corners, corners[[1, 2, 3, 0]] + [0, 0, 0.6], body, equations)
...     largest = advance(T, equations, body, 0.0)
>>> bool(largest < 1e-9), np.round(T @ [0.05, 0, 0, 1], 6).tolist()
(True, [0.0, 0.05, 0.6, 1.0])
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.support.jit import jit, jit_dividing


@jit
def rotation_exp_into(x: float, y: float, z: float, R: Float64) -> None:
    """Write the rotation matrix (3, 3) of the rotation vector (x, y, z) in radians into `R`."""
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    if angle < 1e-6:
        s, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        s, c = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y
    R[1, 0], R[1, 1], R[1, 2] = c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x
    R[2, 0], R[2, 1], R[2, 2] = c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)


@jit
def solve_symmetric(A: Float64, b: Float64, x: Float64) -> bool:
    """Solve the symmetric positive definite system `A x = b` (n, n) by Cholesky; only the lower triangle of
    `A` is read, and it is overwritten by its factor. False when `A` is not positive definite."""
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if total <= 0.0:
                    return False
                A[i, i] = np.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= A[i, k] * x[k]
        x[i] = total / A[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= A[k, i] * x[k]
        x[i] = total / A[i, i]
    return True


@jit
def tukey(square: float) -> float:
    """Tukey's biweight: 0 beyond the gate, so outliers have no influence. square: (residual / gate)**2.

    >>> [tukey(s) for s in (0.0, 0.25, 1.0, 9.0)]
    [1.0, 0.5625, 0.0, 0.0]
    """
    return (1.0 - square) ** 2 if square < 1.0 else 0.0


@jit
def cauchy(square: float) -> float:
    """Cauchy's weight: every residual has an influence, large ones little. square: (residual / scale)**2.

    >>> [cauchy(s) for s in (0.0, 1.0, 9.0)]
    [1.0, 0.5, 0.1]
    """
    return 1.0 / (1.0 + square)


Row = tuple[float, float, float, float, float, float]
"""Derivatives of the present value of a residual with respect to the six components of a step."""

DAMPING = 1e-3
"""Share of the residuals' weight that is used as damping: it keeps the pose where they do not fix it."""

FEWEST_FOR_A_STEP = 6
"""Fewest samples for a step: as many as it has unknowns."""


class Body(NamedTuple):
    """centre (3,): metres, object axes, about which a step rotates; radius: metres, converts a rotation in
    radians to a length."""

    centre: Float64
    radius: float


class NormalEquations(NamedTuple):
    """`A @ step = b` of N unknowns: A (N, N), of which only the lower triangle is kept; b (N,); step (N,) is
    written by `advance`."""

    A: Float64
    b: Float64
    step: Float64


@jit
def normal_equations(unknowns: int) -> NormalEquations:
    """Empty equations."""
    return NormalEquations(np.zeros((unknowns, unknowns)), np.zeros(unknowns), np.zeros(unknowns))


@jit
def clear(equations: NormalEquations) -> None:
    """Remove all residuals."""
    equations.A[:] = 0.0
    equations.b[:] = 0.0


@jit_dividing
def motion_row(p0: float, p1: float, p2: float, g0: float, g1: float, g2: float, body: Body) -> Row:
    """By how much the point p of the object (object axes) moves along g (object axes) with a step."""
    c, radius = body.centre, body.radius
    a0, a1, a2 = (p0 - c[0]) / radius, (p1 - c[1]) / radius, (p2 - c[2]) / radius
    return (g0, g1, g2, a1 * g2 - a2 * g1, a2 * g0 - a0 * g2, a0 * g1 - a1 * g0)


@jit_dividing
def motion_row_cam(
    T: Float64, p0: float, p1: float, p2: float, g0: float, g1: float, g2: float, body: Body
) -> Row:
    """The same for a direction g along camera axes; p is still in object axes."""
    o0 = T[0, 0] * g0 + T[1, 0] * g1 + T[2, 0] * g2
    o1 = T[0, 1] * g0 + T[1, 1] * g1 + T[2, 1] * g2
    o2 = T[0, 2] * g0 + T[1, 2] * g1 + T[2, 2] * g2
    return motion_row(p0, p1, p2, o0, o1, o2, body)


@jit_dividing
def image_row(
    T: Float64, p0: float, p1: float, p2: float, gu: float, gv: float, camera: Float64, body: Body
) -> Row:
    """By how much a function of the image changes under the point p (object axes), where its gradient is
    (gu, gv) per pixel right and down; camera (4,): fx, fy, cx, cy."""
    x = T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]
    y = T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]
    z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
    g0, g1 = gu * camera[0] / z, gv * camera[1] / z
    return motion_row_cam(T, p0, p1, p2, g0, g1, -(g0 * x + g1 * y) / z, body)


@jit_dividing
def add_residual(equations: NormalEquations, weight: float, residual: float, row: Row) -> None:
    """Add one residual to the lower triangle."""
    A, b = equations.A, equations.b
    for i in range(len(row)):
        weighted = weight * row[i]
        b[i] += weighted * residual
        for j in range(i + 1):
            A[i, j] += weighted * row[j]


@jit
def advance(
    T: Float64, equations: NormalEquations, body: Body, damping: float, relaxation: float = 1.0
) -> float:
    """Solve, and move the pose T (4, 4) by the step; `A` is overwritten.

    damping: added to the diagonal, so in the unit of `A`; relaxation: factor of the step. Returns the largest
    of the first six components of the step, absolute, metres; -1 if the system could not be solved, then the
    pose is not moved.
    """
    A, x = equations.A, equations.step
    for i in range(A.shape[0]):
        A[i, i] += damping + 1e-12
    if not solve_symmetric(A, equations.b, x):
        return -1.0
    for i in range(6):
        x[i] *= relaxation
    move(T, x, body)
    return float(max(abs(x[0]), abs(x[1]), abs(x[2]), abs(x[3]), abs(x[4]), abs(x[5])))


@jit
def move(T: Float64, step: Float64, body: Body) -> None:
    """Apply a step (6,) to the pose T (4, 4), in place."""
    centre, radius = body.centre, body.radius
    D = np.empty((3, 3))
    rotation_exp_into(step[3] / radius, step[4] / radius, step[5] / radius, D)
    s0, s1, s2 = centre[0] - step[0], centre[1] - step[1], centre[2] - step[2]
    o0 = centre[0] - D[0, 0] * s0 - D[0, 1] * s1 - D[0, 2] * s2
    o1 = centre[1] - D[1, 0] * s0 - D[1, 1] * s1 - D[1, 2] * s2
    o2 = centre[2] - D[2, 0] * s0 - D[2, 1] * s1 - D[2, 2] * s2
    for r in range(3):
        a0, a1, a2 = T[r, 0], T[r, 1], T[r, 2]
        T[r, 3] += a0 * o0 + a1 * o1 + a2 * o2
        for k in range(3):
            T[r, k] = a0 * D[0, k] + a1 * D[1, k] + a2 * D[2, k]


def information(A: Float64, T_cam_obj: Float64, body: Body) -> Float64:
    """Information (6, 6) that the normal equations (their lower triangle (6, 6), before `advance`) give about
    a pose (4, 4): with respect to `se3.perturb`, so tx ty tz rx ry rz in metres and radians, camera axes,
    about the object's origin. Its inverse is the covariance, where the weights were 1 / variance."""
    out = np.empty((6, 6))
    _information(A, T_cam_obj, body, out)
    return out


@jit
def _information(A: Float64, T: Float64, body: Body, out: Float64) -> None:
    """Fill `out` (6, 6) for a pose T (4, 4)."""
    x, y, z = body.centre[0], body.centre[1], body.centre[2]
    to_step, full = np.zeros((6, 6)), np.empty((6, 6))
    for r in range(3):
        a, b, c = T[r, 0], T[r, 1], T[r, 2]
        to_step[0, r], to_step[1, r], to_step[2, r] = a, b, c
        # A rotation about the origin also moves the centre.
        to_step[0, 3 + r], to_step[1, 3 + r], to_step[2, 3 + r] = z * b - y * c, x * c - z * a, y * a - x * b
        a, b, c = body.radius * a, body.radius * b, body.radius * c
        to_step[3, 3 + r], to_step[4, 3 + r], to_step[5, 3 + r] = a, b, c
    for i in range(6):
        for j in range(i + 1):
            full[i, j] = full[j, i] = A[i, j]
    transform(to_step, full, out)


@jit
def transform(X: Float64, A: Float64, out: Float64) -> None:
    """Write X^T A X into `out`; all (6, 6)."""
    half = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            half[i, j] = 0.0
            for k in range(6):
                half[i, j] += A[i, k] * X[k, j]
    for i in range(6):
        for j in range(6):
            out[i, j] = 0.0
            for k in range(6):
                out[i, j] += X[k, i] * half[k, j]
