"""Two factors whose correspondences are found by projection, close to the right pose: samples of the surface
onto the depth image, and edges of the texture onto the image's edges.

A depth sample is compared, along its normal, with the reading of the pixel that it falls on (Blais and Levine
1995). It needs no scene points and no search.

Edges are the 2D cues that the paper's authors leave to later work (section V). The model's colour pairs are
projected, and each is matched with a nearby colour pair of the image of similar direction and contrast. The
residual is the distance across the edge, in metres at its depth; the distance along the edge does not count.
Contrasts are differences of opponents (see `colorpair.opponents`), which coloured light does not change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.colorpair.lifting import MIN_FACING
from huepose.colorpair.opponents import opponents_of_lab
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry.arrays import Float, Float32, Float64, Int32
from huepose.geometry.camera import NEAREST_M, Camera
from huepose.model.types import Surface
from huepose.refine.solver import Body, NormalEquations, add_residual, image_row, motion_row, tukey
from huepose.support.jit import jit, jit_dividing


class DepthImage(NamedTuple):
    """depth (h, w) metres, 0 = nothing; camera (4,): its fx, fy, cx, cy."""

    depth: Float32
    camera: Float64


class DepthSamples(NamedTuple):
    """points (N, 3) and normals (N, 3) of the model, object axes; weight of each."""

    points: Float32
    normals: Float32
    weight: float


def depth_image(depth: Float32, camera: Camera) -> DepthImage:
    """Bundle a depth image's arrays for the kernels."""
    return DepthImage(np.ascontiguousarray(depth), camera.lens)


def depth_samples(surface: Surface, T_cam_obj: Float64, count: int, weight: float) -> DepthSamples:
    """At most `count` samples of a surface that are visible from the camera."""
    to_camera = -T_cam_obj[:3, :3].T @ (T_cam_obj[:3, :3] @ surface.centre + T_cam_obj[:3, 3])
    view = int(np.argmax(surface.directions @ to_camera))
    shown = surface.visible[surface.offsets[view] : surface.offsets[view + 1]][:count]
    return DepthSamples(
        np.ascontiguousarray(surface.points[shown]), np.ascontiguousarray(surface.normals[shown]), weight
    )


@jit_dividing
def add_depth_samples(
    T: Float64,
    samples: DepthSamples,
    image: DepthImage,
    body: Body,
    gate_m: float,
    equations: NormalEquations,
) -> float:
    """Add the distances along the normals of the samples within `gate_m`; returns their weight."""
    depth, points, normals = image.depth, samples.points, samples.normals
    fx, fy, cx, cy = image.camera[0], image.camera[1], image.camera[2], image.camera[3]
    height, width = depth.shape
    total = 0.0
    for i in range(points.shape[0]):
        p0, p1, p2 = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        x = T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]
        y = T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]
        z = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
        if z < NEAREST_M:
            continue
        u, v = int(np.floor(x / z * fx + cx + 0.5)), int(np.floor(y / z * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        seen = depth[v, u]
        if seen <= 0.0:
            continue
        e0, e1, e2 = (u - cx) / fx * seen - x, (v - cy) / fy * seen - y, seen - z
        n0, n1, n2 = np.float64(normals[i, 0]), np.float64(normals[i, 1]), np.float64(normals[i, 2])
        m0 = T[0, 0] * n0 + T[0, 1] * n1 + T[0, 2] * n2
        m1 = T[1, 0] * n0 + T[1, 1] * n1 + T[1, 2] * n2
        m2 = T[2, 0] * n0 + T[2, 1] * n1 + T[2, 2] * n2
        distance = m0 * e0 + m1 * e1 + m2 * e2
        w = samples.weight * tukey((distance / gate_m) ** 2)
        if w > 0.0:
            add_residual(equations, w, distance, motion_row(p0, p1, p2, n0, n1, n2, body))
            total += w
    return total


DEPTH_GATE_M = 0.006
"""Largest distance of depth from the position of an edge, metres."""

CELL_PX = 8.0
"""Side of the cells by which the edges near a pixel are found."""

ALONG_PX, ALONG_SHARE = 3.0, 0.3
"""Search distance along an edge for its partner, pixels, and weight of a distance along it in the choice,
against one across it."""

MIN_COSINE, MIN_CONTRAST = 0.9, 0.8
"""Least cosine between the directions of an edge and its partner, and between their contrasts."""


class ImageEdges(NamedTuple):
    """Edges of an image: pixels (N, 2), directions (N, 2) across them, contrasts (N, 3) as unit opponents."""

    pixels: Float64
    directions: Float64
    contrasts: Float64


class ModelEdges(NamedTuple):
    """Edges of a model's texture: positions (N, 3), normals (N, 3) and tangents (N, 3) across them in the
    object's axes, contrasts (N, 3) as unit opponents."""

    points: Float32
    normals: Float32
    tangents: Float32
    contrasts: Float64


class EdgeCells(NamedTuple):
    """Lists of the image's edges in each cell: the first of each, and the next after each, -1 for none."""

    head: Int32
    follow: Int32


def image_edges(pairs: ColorPairs) -> ImageEdges:
    """The part of an image's colour pairs that is compared."""
    directions = np.stack([np.cos(pairs.directions), np.sin(pairs.directions)], 1)
    return ImageEdges(pairs.pixels.astype(np.float64), directions.astype(np.float64), contrasts(pairs.colors))


def model_edges(pairs: SurfacePairs) -> ModelEdges:
    """The part of a model's colour pairs that is compared; made once per model."""
    return ModelEdges(
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


@jit
def edge_cells(edges: ImageEdges, height: int, width: int) -> EdgeCells:
    """The edges of an image of that size by cells of CELL_PX."""
    pixels = edges.pixels
    head = np.full((int(height / CELL_PX) + 1, int(width / CELL_PX) + 1), -1, np.int32)
    follow = np.full(pixels.shape[0], -1, np.int32)
    for j in range(pixels.shape[0]):
        row = min(max(int(pixels[j, 1] / CELL_PX), 0), head.shape[0] - 1)
        column = min(max(int(pixels[j, 0] / CELL_PX), 0), head.shape[1] - 1)
        follow[j] = head[row, column]
        head[row, column] = j
    return EdgeCells(head, follow)


@jit_dividing
def add_edges(
    T: Float64,
    model: ModelEdges,
    edges: ImageEdges,
    cells: EdgeCells,
    image: DepthImage,
    body: Body,
    gate_px: float,
    equations: NormalEquations,
) -> tuple[int, float]:
    """Add the distances across the model's edges to their partners in the image; returns how many have a
    partner within `gate_px`, and their weight."""
    depth, points, model_contrasts = image.depth, model.points, model.contrasts
    pixels, directions, scene_contrasts = edges.pixels, edges.directions, edges.contrasts
    head, follow = cells.head, cells.follow
    fx, fy, cx, cy = image.camera[0], image.camera[1], image.camera[2], image.camera[3]
    height, width = depth.shape
    P, n, s = np.empty(3), np.empty(3), np.empty(3)
    matched, total = 0, 0.0
    for i in range(points.shape[0]):
        _in_camera(T, model.points, i, 1.0, P)
        _in_camera(T, model.normals, i, 0.0, n)
        facing = -(n[0] * P[0] + n[1] * P[1] + n[2] * P[2])
        facing /= np.sqrt(P[0] * P[0] + P[1] * P[1] + P[2] * P[2])
        if P[2] < NEAREST_M or facing < MIN_FACING:
            continue
        u, v = P[0] / P[2] * fx + cx, P[1] / P[2] * fy + cy
        if u < 0.0 or v < 0.0 or u > width - 1.0 or v > height - 1.0:
            continue
        seen = depth[int(v + 0.5), int(u + 0.5)]
        if seen <= 0.0 or abs(seen - P[2]) * facing > DEPTH_GATE_M:
            continue
        _in_camera(T, model.tangents, i, 0.0, s)
        a0, a1 = (s[0] - P[0] / P[2] * s[2]) * fx, (s[1] - P[1] / P[2] * s[2]) * fy
        length = np.sqrt(a0 * a0 + a1 * a1)
        if length < 1e-9:
            continue
        a0, a1 = a0 / length, a1 / length
        # Its partner: squared distance in gates, and pixels across.
        best, across = 1.0, 0.0
        row, column = int(v / CELL_PX), int(u / CELL_PX)
        for y in range(max(row - 1, 0), min(row + 2, head.shape[0])):
            for z in range(max(column - 1, 0), min(column + 2, head.shape[1])):
                j = head[y, z]
                while j >= 0:
                    d0, d1 = pixels[j, 0] - u, pixels[j, 1] - v
                    e, f = d0 * a0 + d1 * a1, d1 * a0 - d0 * a1
                    apart = (e / gate_px) ** 2 + ALONG_SHARE * (f / ALONG_PX) ** 2
                    cosine = directions[j, 0] * a0 + directions[j, 1] * a1
                    if apart < best and abs(f) < ALONG_PX and abs(cosine) > MIN_COSINE:
                        alike = 0.0
                        for c in range(3):
                            alike += scene_contrasts[j, c] * model_contrasts[i, c]
                        if alike * (1.0 if cosine > 0.0 else -1.0) > MIN_CONTRAST:
                            best, across = apart, e
                    j = follow[j]
        if best >= 1.0:
            continue
        p0, p1, p2 = (
            np.float64(points[i, 0]),
            np.float64(points[i, 1]),
            np.float64(points[i, 2]),
        )
        w, metres = facing * tukey(best), P[2] / fx
        jacobian = image_row(T, p0, p1, p2, a0, a1, image.camera, body)
        add_residual(equations, w * metres * metres, across, jacobian)  # weighted as metres at its depth
        matched += 1
        total += w
    return matched, total


@jit_dividing
def _in_camera(T: Float64, rows: Float32, i: int, shift: float, out: Float64) -> None:
    """Row i in camera axes: a point with shift 1, a direction with shift 0."""
    for r in range(3):
        out[r] = T[r, 0] * rows[i, 0] + T[r, 1] * rows[i, 1] + T[r, 2] * rows[i, 2] + shift * T[r, 3]
