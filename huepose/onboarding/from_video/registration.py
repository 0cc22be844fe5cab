"""Register a frame with the fused views: start from optical flow, then refine on depth and colour.
Distribute the drift over all views when a loop is closed, by Open3D's pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from huepose.geometry import kabsch, se3
from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.lifting import lift
from huepose.judge.kernel_arrays import ModelArrays
from huepose.judge.open_region import PreparedSurface, open_region, steepest, terms_at
from huepose.judge.terms import Terms
from huepose.onboarding.from_video.fusion import Fused
from huepose.onboarding.from_video.sight import seen_more_squarely
from huepose.onboarding.from_video.views import View
from huepose.propose import flow
from huepose.refine.photometric import COARSE, FULL, refine

SAMPLES = 3000
"""Surface samples for an alignment."""

MATCHES = 400
"""Most pixels whose flow is used."""

WINDOW = 0.35
"""Margin around the object's box for its motion in one frame, over the size of the box."""

MORE_SQUARELY = 0.02
"""A view replaces the colour of a point if the cosine of its viewing angle is larger by this."""

TURNS = np.radians([-24.0, -12.0, 12.0, 24.0])
"""Rotations of initial poses about each axis, radians: refinement converges from starts this far apart."""


@dataclass(frozen=True, eq=False)
class Registered:
    """T_cam_obj (4, 4), and the terms of this pose."""

    T_cam_obj: Float64
    terms: Terms


def surface_of(shape: Fused, views: Sequence[View], T_cam_obj: Float64) -> PreparedSurface | None:
    """The part of a fused surface that is visible at a pose, with the colours of the most frontal views;
    None if too little of it was measured by a view."""
    R, t = T_cam_obj[:3, :3], T_cam_obj[:3, 3]
    p_cam = shape.vertices @ R.T + t
    facing = -((shape.normals @ R.T) * p_cam).sum(1) / np.linalg.norm(p_cam, axis=1) > 0.1
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(facing & shape.seen))[: 3 * SAMPLES]
    points, normals = shape.vertices[chosen], shape.normals[chosen]
    colors, known = _colors(points, normals, views)
    keep = np.flatnonzero(known)[:SAMPLES]
    if len(keep) < 100:
        return None
    points, normals, colors = points[keep], normals[keep], colors[keep]
    spread = points - points.mean(0)
    axes = np.linalg.eigh(spread.T @ spread)[1]
    extents = np.sort(np.ptp(spread @ axes, axis=0))
    centre = 0.5 * (points.min(0) + points.max(0))
    direction = -R.T @ (R @ centre + t)
    arrays = ModelArrays(
        np.ascontiguousarray(points, np.float32),
        np.ascontiguousarray(normals, np.float32),
        np.ascontiguousarray(colors.transpose(1, 0, 2), np.float32),
        (direction / np.linalg.norm(direction))[None].astype(np.float32),
        np.empty((1, 0), np.int32),
        np.arange(len(points), dtype=np.int32),
        np.array([0, len(points)], np.int32),
        np.zeros(3),
        1.0,
        np.zeros((1, 1, 1), np.int16),
        centre,
    )
    # From one side the third extent of the object is unknown: the smaller visible one is assumed.
    return PreparedSurface(
        arrays,
        steepest(arrays.points, arrays.normals, arrays.colors),
        float(extents[-1]),
        float(extents[-2]),
        float(np.linalg.norm(points - centre, axis=1).max()),
    )


def _colors(points: Float64, normals: Float64, views: Sequence[View]) -> tuple[Float32, Bool]:
    """Opponent colours (N, 3, 3) of points at three scales, each from the most frontal view, and which
    points are visible in a view (N,)."""
    best = np.full(len(points), -1.0)
    colors = np.zeros((len(points), 3, 3), np.float32)
    for view in views:
        depth = view.frame.depth
        at = seen_more_squarely(points, normals, *view.camera_at, depth, view.inner, best, MORE_SQUARELY)
        better = np.flatnonzero(at[:, 0] >= 0)
        colors[better] = view.opponents[:, at[better, 0], at[better, 1]].transpose(1, 0, 2)
    return colors, best > 0


def registered(surface: PreparedSurface, frame: RgbdFrame, guesses: Sequence[Float64]) -> Registered | None:
    """The best pose of those refined from the guesses; None if no guess is in the image."""
    best: Registered | None = None
    for guess in guesses:
        box = surface.box(guess, frame.camera)
        if box is None:
            continue
        distance = float(surface.centre_cam(guess)[2])
        region = open_region(frame, box.grown(WINDOW, 8), distance, surface.diameter_m)
        if region is None:
            continue
        coarse = refine(surface, region, guess, COARSE)
        for start in (guess, coarse.T_cam_obj):
            T = refine(surface, region, start, FULL).T_cam_obj
            terms = terms_at(surface, region, T)[0]
            if best is None or terms.total > best.terms.total:
                best = Registered(T, terms)
    return best


def turned_about(T_cam_obj: Float64) -> list[Float64]:
    """A pose, and copies of it that are rotated about each of the camera's axes."""
    rotations = [se3.rotation_exp(angle * axis) for axis in np.eye(3) for angle in TURNS]
    R, t = T_cam_obj[:3, :3], T_cam_obj[:3, 3]
    return [T_cam_obj, *(se3.make(rotation @ R, t) for rotation in rotations)]


def followed(last: RgbdFrame, mask: Bool, T_cam_obj: Float64, frame: RgbdFrame) -> Float64 | None:
    """The pose in a frame by the optical flow of a mask (H, W) since the last frame; None if flow gives no
    motion, or if the image size has changed: then the pixels do not correspond."""
    rows, columns = np.nonzero(mask)
    if not len(rows) or last.color.shape != frame.color.shape:
        return None
    box = Box.of_mask(mask)
    assert box is not None
    moved = flow.compute(last.color, frame.color, box.grown(WINDOW, 8))
    if moved is None:
        return None
    some = np.random.default_rng(0).permutation(len(rows))[:MATCHES]
    pixels = np.stack([columns[some], rows[some]], 1).astype(np.float64)
    by, ok = moved.at(pixels)
    a, known_a = lift(last.depth, last.camera, pixels)
    b, known_b = lift(frame.depth, frame.camera, pixels + by)
    k = ok & known_a & known_b
    motion = kabsch.motion(a[k], b[k])
    return None if motion is None else motion @ T_cam_obj


SIGMA_M = 0.0015
"""Assumed error of a registration of two views, at the object's radius, metres. It is the same for all
edges, so the pose graph recognises only edges with several times this error as outliers."""


class Edge(NamedTuple):
    """T_b_a (4, 4): camera axes of view a to those of view b, as registered; loop: it closes a loop."""

    a: int
    b: int
    T_b_a: Float64
    loop: bool


def relaxed(views: Sequence[View], edges: Sequence[Edge], radius_m: float) -> list[View]:
    """Views with optimised poses; loop edges that contradict the others are dropped."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    # About the object's centre, not the camera's, so that rotations and translations are comparable.
    T_cam_centre = [se3.make(np.eye(3), view.T_cam_obj[:3, 3]) for view in views]
    graph = registration.PoseGraph()
    for view, T in zip(views, T_cam_centre, strict=True):
        graph.nodes.append(registration.PoseGraphNode(se3.inverse(view.T_cam_obj) @ T))
    information = np.diag([radius_m**2] * 3 + [1.0] * 3) / SIGMA_M**2
    for edge in edges:
        T = se3.inverse(T_cam_centre[edge.b]) @ edge.T_b_a @ T_cam_centre[edge.a]
        graph.edges.append(registration.PoseGraphEdge(edge.a, edge.b, T, information, uncertain=edge.loop))
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(
            max_correspondence_distance=5 * SIGMA_M, edge_prune_threshold=0.25, reference_node=0
        ),
    )
    return [
        view.at(se3.orthonormalised(T @ se3.inverse(node.pose)))
        for view, T, node in zip(views, T_cam_centre, graph.nodes, strict=True)
    ]
