"""Looks become proposals: poses are judged on the picture itself, brought onto the depth, and thinned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float64, Int64
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.perception.nearby import align_in_view
from huepose.perception.rim import rims
from huepose.perception.window_look import look, promising
from huepose.perception.window_table import WindowTable
from huepose.perception.windows import windows_of
from huepose.support.stages import stage
from huepose.verification.dense import model_arrays, score_many
from huepose.verification.local_search import search

WINDOWS, LOOKS, LOOKS_EACH = 80, 700, 25
FIRST_SAMPLES, SECOND_SAMPLES = 60, 200
ALIGNED, ALIGNED_EACH = 48, 3
LOOK_WEIGHT = 0.7
RIM_WEIGHT = 0.7
SEARCHED, SEARCH_SAMPLES, SEARCH_STEPS_DEG = 8, 100, (8.0, 4.0)
SAME_SHIFT, SAME_IOU = 0.25, 0.6
"""Poses nearer than this (in diameters), or whose boxes overlap so, are one proposal."""

SEEN_M, PATCH_PX = 0.02, 6


@dataclass(frozen=True, eq=False)
class Proposal:
    """Where an object may be: a rough pose T_cam_obj (4, 4), the box of what is seen of it in the frame, and
    a score; support (N,): numbers of the patches of the picture that show it."""

    T_cam_obj: Float64
    box: Box
    score: float
    support: Int64


def propose(model: ReferenceModel, table: WindowTable, view: ClearView, count: int) -> list[Proposal]:
    """The `count` best different places of an object in a view, best first."""
    with stage("windows"):
        windows = windows_of(view, model.diameter_m, table.views.span_m)
        windows = windows[promising(table, windows, WINDOWS)]
    with stage("look"):
        looks = look(table, windows, view.crop.camera, LOOKS, LOOKS_EACH)
    if not len(looks.poses):
        return []
    region = view.region(model.diameter_m)
    with stage("first"):
        rated = evidence(score_many(model, region, looks.poses, FIRST_SAMPLES)) + LOOK_WEIGHT * looks.scores
        first = looks.poses[_varied(looks.windows, rated)]
    with stage("icp"):
        poses = align_in_view(model, view, first)
    with stage("second"):
        terms = score_many(model, region, poses, SECOND_SAMPLES)
        rated = evidence(terms) - RIM_WEIGHT * rims(view, model_arrays(model), poses, SECOND_SAMPLES)
    with stage("third"):
        best = _apart(model, poses, rated, SEARCHED)
        found, _ = search(model, region, poses[best], SEARCH_STEPS_DEG, SEARCH_SAMPLES)
        poses = np.concatenate([found, poses])
        terms = score_many(model, region, found, SECOND_SAMPLES)
        again = evidence(terms) - RIM_WEIGHT * rims(view, model_arrays(model), found, SECOND_SAMPLES)
        rated = np.concatenate([again, rated])
    with stage("thin"):
        return _thinned(model, view, poses, rated, count)


def evidence(terms: Float64) -> Float64:
    """Score (M,) of poses from the terms (M, 8) of the dense score without an outline."""
    fit, violation, color, seen = terms[:, 1], terms[:, 3], terms[:, 4], terms[:, 6]
    return np.asarray(0.9 * fit - 1.0 * violation + color + 0.3 * np.sqrt(np.clip(seen, 0.0, 1.0)))


def _varied(windows: Int64, rated: Float64) -> Int64:
    """The best ALIGNED of looks (M,), at most ALIGNED_EACH of one window."""
    taken = np.zeros(windows.max() + 1, np.int64)
    chosen = []
    for k in np.argsort(-rated, kind="stable"):
        if taken[windows[k]] < ALIGNED_EACH:
            taken[windows[k]] += 1
            chosen.append(k)
            if len(chosen) == ALIGNED:
                break
    return np.array(chosen)


def _apart(model: ReferenceModel, poses: Float64, rated: Float64, count: int) -> Int64:
    """The best `count` of poses (M, 4, 4) whose middles are apart."""
    centres = poses[:, :3, :3] @ model.mesh.centre + poses[:, :3, 3]
    chosen: list[int] = []
    for k in np.argsort(-rated, kind="stable"):
        away = np.linalg.norm(centres[chosen] - centres[k], axis=1)
        if not chosen or away.min() >= 0.5 * SAME_SHIFT * model.diameter_m:
            chosen.append(int(k))
            if len(chosen) == count:
                break
    return np.array(chosen)


def _thinned(
    model: ReferenceModel, view: ClearView, poses: Float64, rated: Float64, count: int
) -> list[Proposal]:
    centres = poses[:, :3, :3] @ model.mesh.centre + poses[:, :3, 3]
    out: list[Proposal] = []
    chosen: list[Float64] = []
    for k in np.argsort(-rated, kind="stable"):
        if any(np.linalg.norm(centres[k] - c) < SAME_SHIFT * model.diameter_m for c in chosen):
            continue
        seen = seen_part(model, view, poses[k])
        if seen is None or any(seen[0].iou(p.box) > SAME_IOU for p in out):
            continue
        out.append(Proposal(poses[k], seen[0], float(rated[k]), seen[1]))
        chosen.append(centres[k])
        if len(out) == count:
            break
    return out


def seen_part(
    model: ReferenceModel, view: ClearView, T_cam_obj: Float64, samples: int = 400
) -> tuple[Box, Int64] | None:
    """Bounds in the frame of the surface samples that agree with the depth, and the patches of the picture
    that they lie in; None where hardly any does."""
    s = model.surface
    eye = -T_cam_obj[:3, :3].T @ T_cam_obj[:3, 3]
    k = int(np.argmax(s.directions @ eye))
    seen = s.visible[s.offsets[k] : s.offsets[k + 1]][:samples]
    points = s.points[seen] @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3]
    pixels = view.crop.camera.project(points)
    u, v = np.rint(pixels[:, 0]), np.rint(pixels[:, 1])
    h, w = view.clear.shape
    inside = (u >= 0) & (v >= 0) & (u < w) & (v < h)
    u, v, z = u[inside].astype(int), v[inside].astype(int), points[inside, 2]
    depth = view.crop.depth[v, u]
    fits = (np.abs(depth - z) < SEEN_M) & (depth > 0)
    if fits.sum() < 5:
        return None
    box = Box.of_pixels(pixels[inside][fits])
    patches = np.unique((v[fits] // PATCH_PX) * w + u[fits] // PATCH_PX)
    return Box(box.x + view.crop.x0, box.y + view.crop.y0, box.w, box.h), patches
