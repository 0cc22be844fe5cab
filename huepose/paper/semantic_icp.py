"""Semantic ICP: refine a pose on the classified cloud, per class and over all classes together (paper,
III-D).

In each iteration every scene point gets two correspondences: its nearest model point of the same class, which
aligns the texture, and its nearest model point of any class, which helps where a class has few points. Both
enter one weighted system for one pose increment. Residuals are point-to-plane; same-class correspondences
also have a small tangential part, because a plane does not fix where on a face its colours are. The levels go
from few points and a wide gate to all points and a narrow one, with Tukey weights within the gate and a
damped step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64, Int32, Int64, UInt8
from huepose.model.types import PaperTables
from huepose.paper.cloud import ClassifiedCloud
from huepose.refine.solver import (
    DAMPING,
    FEWEST_FOR_A_STEP,
    Body,
    NormalEquations,
    add_residual,
    advance,
    clear,
    motion_row,
    normal_equations,
    tukey,
)
from huepose.support.jit import jit

STEP_TOLERANCE_M = 2e-6  # converged if a step moves no point by more


SEMANTIC, AGGREGATE = 1.0, 0.5
"""Weights of the correspondences within a class and over all classes."""

SLIDING = 0.1
"""Weight of the residual along the surface against that across it, for correspondences of one class."""


class _Level(NamedTuple):
    """gate: in diameters of the model's cloud; stride, model_stride: every stride-th scene point and every
    model_stride-th model point is used."""

    gate: float
    stride: int
    model_stride: int
    iterations: int


LEVELS = (_Level(0.35, 4, 8, 10), _Level(0.15, 3, 4, 8), _Level(0.06, 2, 2, 6), _Level(0.02, 1, 1, 6))


class _Scene(NamedTuple):
    """The scene's points of one level, for the kernels."""

    points: Float64
    classes: UInt8
    weights: Float64


class _Cloud(NamedTuple):
    """The model's points of one level, and a grid of cells over them. shape (3,): of the grid; table: each
    cell's number among the cells with points, or -1; order: the points in order of their cells; starts: where
    each cell begins in `order`; low: the lowest corner; gate: of the level, and the side of a cell."""

    points: Float64
    normals: Float64
    classes: UInt8
    shape: Int64
    table: Int32
    order: Int32
    starts: Int32
    low: Float64
    gate: float


def semantic_icp_many(reference: PaperTables, scene: ClassifiedCloud, poses: Float) -> Float64:
    """Poses T_cam_obj (M, 4, 4), each refined on a scene's classified cloud in camera axes."""
    model = np.ascontiguousarray(reference.cloud_points, np.float64)
    T = np.array(poses, dtype=np.float64)
    points = np.ascontiguousarray(scene.points, np.float64)
    if not len(model) or not len(points):
        return T
    low = model.min(0)
    centre = 0.5 * (low + model.max(0))
    radius = float(np.linalg.norm(model - centre, axis=1).max())
    body = Body(centre, radius)
    for level in LEVELS:
        observed = _Scene(
            np.ascontiguousarray(points[:: level.stride]),
            np.ascontiguousarray(scene.classes[:: level.stride]),
            np.ascontiguousarray(scene.weights[:: level.stride], np.float64),
        )
        cloud = _cloud(reference, level.model_stride, 2.0 * radius * level.gate)
        _align_all(T, observed, cloud, body, level.iterations)
    return np.stack([se3.orthonormalised(pose) for pose in T])


def _cloud(reference: PaperTables, stride: int, gate: float) -> _Cloud:
    """Every `stride`-th point of the model's classified cloud, in cells as large as the gate."""
    low = np.ascontiguousarray(reference.cloud_points, np.float64).min(0)
    points = np.ascontiguousarray(reference.cloud_points[::stride], np.float64)
    cell = np.floor((points - low) / gate).astype(np.int64)
    shape = cell.max(0) + 1
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(flat, kind="stable").astype(np.int32)
    numbers, starts = np.unique(flat[order], return_index=True)
    table = np.full(int(shape.prod()) + 1, -1, np.int32)
    table[numbers] = np.arange(len(numbers))
    return _Cloud(
        points,
        np.ascontiguousarray(reference.cloud_normals[::stride], np.float64),
        np.ascontiguousarray(reference.cloud_classes[::stride]),
        shape,
        table,
        order,
        np.append(starts, len(points)).astype(np.int32),
        low,
        gate,
    )


@jit
def _nearest(q0: float, q1: float, q2: float, kind: int, cloud: _Cloud) -> int:
    """Index of the model point nearest to q within one cell's size, of class `kind` (-1: any class); -1 if
    there is none."""
    model, classes, low, size = cloud.points, cloud.classes, cloud.low, cloud.gate
    shape, table, order, starts = cloud.shape, cloud.table, cloud.order, cloud.starts
    c0 = int(np.floor((q0 - low[0]) / size))
    c1 = int(np.floor((q1 - low[1]) / size))
    c2 = int(np.floor((q2 - low[2]) / size))
    best, at = size * size, -1
    for x in range(max(c0 - 1, 0), min(c0 + 2, shape[0])):
        for y in range(max(c1 - 1, 0), min(c1 + 2, shape[1])):
            for z in range(max(c2 - 1, 0), min(c2 + 2, shape[2])):
                k = table[(x * shape[1] + y) * shape[2] + z]
                if k < 0:
                    continue
                for s in range(starts[k], starts[k + 1]):
                    j = order[s]
                    if kind >= 0 and classes[j] != kind:
                        continue
                    d = (model[j, 0] - q0) ** 2 + (model[j, 1] - q1) ** 2 + (model[j, 2] - q2) ** 2
                    if d < best:
                        best = d
                        at = j
    return at


@jit
def _align_all(poses: Float64, scene: _Scene, cloud: _Cloud, body: Body, rounds: int) -> None:
    """Refine the poses on one level, in place."""
    equations = normal_equations(6)
    for m in range(poses.shape[0]):
        for _ in range(rounds):
            clear(equations)
            matched, weight = _add_semantic(poses[m], scene, cloud, body, equations)
            if matched < FEWEST_FOR_A_STEP:
                break
            # `advance` is negative if the system has no solution.
            if advance(poses[m], equations, body, DAMPING * weight) < STEP_TOLERANCE_M:
                break


@jit
def _add_semantic(
    T: Float64, scene: _Scene, cloud: _Cloud, body: Body, equations: NormalEquations
) -> tuple[int, float]:
    """Factor: add the residuals of both kinds of correspondences; return their number and total weight."""
    points, model, normals = scene.points, cloud.points, cloud.normals
    matched, total = 0, 0.0
    for i in range(points.shape[0]):
        p0, p1, p2 = points[i, 0] - T[0, 3], points[i, 1] - T[1, 3], points[i, 2] - T[2, 3]
        q0 = T[0, 0] * p0 + T[1, 0] * p1 + T[2, 0] * p2
        q1 = T[0, 1] * p0 + T[1, 1] * p1 + T[2, 1] * p2
        q2 = T[0, 2] * p0 + T[1, 2] * p1 + T[2, 2] * p2
        for which in range(2):
            kind = int(scene.classes[i]) if which == 0 else -1
            j = _nearest(q0, q1, q2, kind, cloud)
            if j < 0:
                continue
            e0, e1, e2 = q0 - model[j, 0], q1 - model[j, 1], q2 - model[j, 2]
            w = scene.weights[i] * (SEMANTIC if which == 0 else AGGREGATE)
            w *= tukey((e0 * e0 + e1 * e1 + e2 * e2) / (cloud.gate * cloud.gate))
            n0, n1, n2 = normals[j, 0], normals[j, 1], normals[j, 2]
            across = e0 * n0 + e1 * n1 + e2 * n2
            add_residual(equations, w, across, motion_row(q0, q1, q2, n0, n1, n2, body))
            matched += 1
            total += w
            if which == 0:
                # The residual along the surface, axis by axis.
                for a in range(3):
                    n = n0 if a == 0 else n1 if a == 1 else n2
                    u0 = (1.0 if a == 0 else 0.0) - n * n0
                    u1 = (1.0 if a == 1 else 0.0) - n * n1
                    u2 = (1.0 if a == 2 else 0.0) - n * n2
                    along = e0 * u0 + e1 * u1 + e2 * u2
                    row = motion_row(q0, q1, q2, u0, u1, u2, body)
                    add_residual(equations, w * SLIDING, along, row)
    return matched, total
