"""Edges of the print as they lie in the image, and depth, refine a pose together (paper, section V: the 2D
cues that its authors leave to later work).

Depth tells little of how an object may slide and turn along its own faces; the image tells that to a
fraction of a pixel. The model's colour pairs are projected; each looks near its place for a colour pair of
the image of like direction and like contrast, and the distance across the edge is its residual, in metres at
its depth. Along the edge nothing is asked. With the residuals of point to plane between depth and the
surface's visible samples they enter one weighted system, from a wide gate to a narrow one; weights are
Tukey's. Contrasts are differences of opponents (see `colorpair.opponents`), which coloured light leaves as
they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.colorpair.opponents import opponents_of_lab
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64, Int32
from huepose.geometry.camera import Camera
from huepose.geometry.kernels import rotation_exp_into, solve_symmetric
from huepose.model.types import Surface
from huepose.support.jit import jit

MIN_FACING = 0.25
DAMPING = 1e-3
CELL_PX = 8.0


@dataclass(frozen=True)
class EdgeIcpConfig:
    """gates_px: how far across the edge is looked, one iteration each; along_px: how far along it;
    min_cosine: of the directions of two edges; min_contrast: cosine of their contrasts; depth: weight of a
    depth residual against one of an edge, both in metres; gate_m: of depth residuals; samples: of the
    surface; fewest: edges that have to be matched for a pose to be moved."""

    gates_px: tuple[float, ...] = (5.0, 4.0, 3.0, 2.5, 2.0, 2.0, 1.5, 1.5)
    along_px: float = 3.0
    min_cosine: float = 0.9
    min_contrast: float = 0.8
    depth: float = 0.3
    gate_m: float = 0.006
    samples: int = 300
    fewest: int = 15


@dataclass(frozen=True, eq=False)
class ImageEdges:
    """Edges of an image: pixels (N, 2), directions (N, 2) across them, contrasts (N, 3) as unit opponents."""

    pixels: Float64
    directions: Float64
    contrasts: Float64


@dataclass(frozen=True, eq=False)
class PrintEdges:
    """Edges of a model's print: places (N, 3), normals (N, 3) and tangents (N, 3) across them in the object's
    axes, contrasts (N, 3) as unit opponents."""

    points: Float32
    normals: Float32
    tangents: Float32
    contrasts: Float64


@dataclass(frozen=True, eq=False)
class EdgeAlignment:
    """T_cam_obj (4, 4); matched: edges in the last iteration, 0 when the pose was left alone; rms_px: their
    distance across the edge then."""

    T_cam_obj: Float64
    matched: int
    rms_px: float


def image_edges(pairs: ColorPairs) -> ImageEdges:
    """What of an image's colour pairs is compared."""
    directions = np.stack([np.cos(pairs.directions), np.sin(pairs.directions)], 1)
    return ImageEdges(pairs.pixels.astype(np.float64), directions.astype(np.float64), contrasts(pairs.colors))


def print_edges(pairs: SurfacePairs) -> PrintEdges:
    """What of a model's colour pairs is compared: made once for a model, used for every pose of it."""
    return PrintEdges(
        np.ascontiguousarray(pairs.points, dtype=np.float32),
        np.ascontiguousarray(pairs.normals, dtype=np.float32),
        np.ascontiguousarray(pairs.tangents, dtype=np.float32),
        contrasts(pairs.colors),
    )


def contrasts(colors: Float) -> Float64:
    """Unit differences (N, 3) of the opponents of CIELAB colours (N, 2, 3), side 1 less side 0."""
    ends = opponents_of_lab(colors).astype(np.float64)
    steps = ends[:, 1] - ends[:, 0]
    return np.asarray(steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-9))


def edge_icp(
    model: PrintEdges,
    surface: Surface,
    edges: ImageEdges,
    depth: Float32,
    camera: Camera,
    T_cam_obj: Float,
    config: EdgeIcpConfig | None = None,
) -> EdgeAlignment:
    """Move the object so that its print lies on the image's edges and its surface on the depth.

    model: the edges of its print; depth (h, w) metres, 0 = nothing, of the camera that saw the edges.
    The pose comes back unchanged where fewer than `fewest` edges match.
    """
    config = config or EdgeIcpConfig()
    start = np.array(T_cam_obj, dtype=np.float64)
    if not len(model.points):
        return EdgeAlignment(start, 0, 0.0)
    T = start.copy()
    looked = -T[:3, :3].T @ T[:3, 3]
    view = int(np.argmax(surface.directions @ looked))
    shown = surface.visible[surface.offsets[view] : surface.offsets[view + 1]][: config.samples]
    low, high = surface.points.min(0).astype(np.float64), surface.points.max(0).astype(np.float64)
    report = np.zeros(2)
    _refine(
        T,
        model.points,
        model.normals,
        model.tangents,
        model.contrasts,
        edges.pixels,
        edges.directions,
        edges.contrasts,
        np.ascontiguousarray(surface.points[shown]),
        np.ascontiguousarray(surface.normals[shown]),
        np.ascontiguousarray(depth),
        np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        np.array(config.gates_px),
        np.array([config.along_px, config.min_cosine, config.min_contrast, config.depth, config.gate_m]),
        0.5 * (low + high),
        0.5 * float(np.linalg.norm(high - low)),
        report,
    )
    if report[0] < config.fewest:
        return EdgeAlignment(start, 0, 0.0)
    return EdgeAlignment(se3.orthonormalised(T), int(report[0]), float(report[1]))


@jit
def _refine(
    T: Float64,
    points: Float32,
    normals: Float32,
    tangents: Float32,
    model_contrasts: Float64,
    pixels: Float64,
    directions: Float64,
    scene_contrasts: Float64,
    samples: Float32,
    sample_normals: Float32,
    depth: Float32,
    lens: Float64,
    gates: Float64,
    limits: Float64,
    centre_obj: Float64,
    radius: float,
    report: Float64,
) -> None:
    head, follow = _cells(pixels, depth.shape[0], depth.shape[1])
    A, b, x, D = np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros((3, 3))
    centre, P, n, s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    height, width = depth.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    along_px, min_cosine, min_contrast, depth_weight, gate_m = limits
    for level in range(gates.shape[0]):
        gate = gates[level]
        A[:] = 0.0
        b[:] = 0.0
        for r in range(3):
            centre[r] = T[r, 3]
            for c in range(3):
                centre[r] += T[r, c] * centre_obj[c]
        matched, total, squares = 0, 0.0, 0.0
        for i in range(points.shape[0]):
            _moved(T, points, i, 1.0, P)
            _moved(T, normals, i, 0.0, n)
            facing = -(n[0] * P[0] + n[1] * P[1] + n[2] * P[2])
            facing /= np.sqrt(P[0] * P[0] + P[1] * P[1] + P[2] * P[2])
            if P[2] < 0.02 or facing < MIN_FACING:
                continue
            u, v = P[0] / P[2] * fx + cx, P[1] / P[2] * fy + cy
            if u < 0.0 or v < 0.0 or u > width - 1.0 or v > height - 1.0:
                continue
            seen = depth[int(v + 0.5), int(u + 0.5)]
            if seen <= 0.0 or abs(seen - P[2]) * facing > gate_m:
                continue
            _moved(T, tangents, i, 0.0, s)
            a0, a1 = (s[0] - P[0] / P[2] * s[2]) * fx, (s[1] - P[1] / P[2] * s[2]) * fy
            length = np.sqrt(a0 * a0 + a1 * a1)
            if length < 1e-9:
                continue
            a0, a1 = a0 / length, a1 / length
            best, across = 1.0, 0.0
            row, column = int(v / CELL_PX), int(u / CELL_PX)
            for y in range(max(row - 1, 0), min(row + 2, head.shape[0])):
                for z in range(max(column - 1, 0), min(column + 2, head.shape[1])):
                    j = head[y, z]
                    while j >= 0:
                        d0, d1 = pixels[j, 0] - u, pixels[j, 1] - v
                        e, f = d0 * a0 + d1 * a1, d1 * a0 - d0 * a1
                        apart = (e / gate) ** 2 + 0.3 * (f / along_px) ** 2
                        cosine = directions[j, 0] * a0 + directions[j, 1] * a1
                        if apart < best and abs(f) < along_px and abs(cosine) > min_cosine:
                            alike = 0.0
                            for c in range(3):
                                alike += scene_contrasts[j, c] * model_contrasts[i, c]
                            if alike * (1.0 if cosine > 0.0 else -1.0) > min_contrast:
                                best, across = apart, e
                        j = follow[j]
            if best >= 1.0:
                continue
            metres = P[2] / fx
            w = facing * (1.0 - best) ** 2
            g0, g1 = a0, a1 * fy / fx
            g2 = -(g0 * P[0] + g1 * P[1]) / P[2]
            _add(A, b, w, across * metres, g0, g1, g2, P, centre, radius)
            matched += 1
            total += w
            squares += w * across * across
        report[0] = matched
        report[1] = np.sqrt(squares / total) if total > 0.0 else 0.0
        if matched < 6:
            return
        for i in range(samples.shape[0]):
            _moved(T, samples, i, 1.0, P)
            _moved(T, sample_normals, i, 0.0, n)
            if P[2] < 0.02:
                continue
            u, v = int(P[0] / P[2] * fx + cx + 0.5), int(P[1] / P[2] * fy + cy + 0.5)
            if u < 0 or v < 0 or u >= width or v >= height:
                continue
            seen = depth[v, u]
            if seen <= 0.0:
                continue
            q0, q1 = (u - cx) / fx * seen - P[0], (v - cy) / fy * seen - P[1]
            off = n[0] * q0 + n[1] * q1 + n[2] * (seen - P[2])
            share = off / gate_m
            if abs(share) < 1.0:
                w = depth_weight * (1.0 - share * share) ** 2
                _add(A, b, w, off, n[0], n[1], n[2], P, centre, radius)
                total += w
        for k in range(6):
            A[k, k] += DAMPING * total + 1e-12
        if not solve_symmetric(A, b, x):
            return
        _turn(T, x, centre, radius, D)


@jit
def _cells(pixels: Float64, height: int, width: int) -> tuple[Int32, Int32]:
    """Lists of the edges in each cell of the image: the first of each, and the next after each."""
    head = np.full((int(height / CELL_PX) + 1, int(width / CELL_PX) + 1), -1, np.int32)
    follow = np.full(pixels.shape[0], -1, np.int32)
    for j in range(pixels.shape[0]):
        row = min(max(int(pixels[j, 1] / CELL_PX), 0), head.shape[0] - 1)
        column = min(max(int(pixels[j, 0] / CELL_PX), 0), head.shape[1] - 1)
        follow[j] = head[row, column]
        head[row, column] = j
    return head, follow


@jit
def _moved(T: Float64, rows: Float32, i: int, shift: float, out: Float64) -> None:
    """Row i in camera axes: a point with shift 1, a direction with shift 0."""
    for r in range(3):
        out[r] = T[r, 0] * rows[i, 0] + T[r, 1] * rows[i, 1] + T[r, 2] * rows[i, 2] + shift * T[r, 3]


@jit
def _add(
    A: Float64,
    b: Float64,
    w: float,
    residual: float,
    g0: float,
    g1: float,
    g2: float,
    P: Float64,
    centre: Float64,
    radius: float,
) -> None:
    """One residual (metres that the point should move along g) into the normal equations; unknowns are a
    shift and a turn about `centre`, both as lengths over the object's radius."""
    r0, r1, r2 = (P[0] - centre[0]) / radius, (P[1] - centre[1]) / radius, (P[2] - centre[2]) / radius
    row = (g0, g1, g2, r1 * g2 - r2 * g1, r2 * g0 - r0 * g2, r0 * g1 - r1 * g0)
    for k in range(6):
        b[k] += w * row[k] * residual / radius
        for m in range(k + 1):
            A[k, m] += w * row[k] * row[m]


@jit
def _turn(T: Float64, x: Float64, centre: Float64, radius: float, D: Float64) -> None:
    """Turn a pose about `centre` by x[3:] (radians) and shift it by x[:3] (radii), in camera axes."""
    rotation_exp_into(x[3], x[4], x[5], D)
    t0, t1, t2 = T[0, 3] - centre[0], T[1, 3] - centre[1], T[2, 3] - centre[2]
    for r in range(3):
        T[r, 3] = centre[r] + D[r, 0] * t0 + D[r, 1] * t1 + D[r, 2] * t2 + x[r] * radius
    for c in range(3):
        a0, a1, a2 = T[0, c], T[1, c], T[2, c]
        for r in range(3):
            T[r, c] = D[r, 0] * a0 + D[r, 1] * a1 + D[r, 2] * a2
