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
from huepose.perception.windows import Windows, windows_of
from huepose.support.stages import stage
from huepose.verification.dense import score_many
from huepose.verification.kernel_arrays import model_arrays
from huepose.verification.local_search import search
from huepose.verification.region import Region

FIRST_SAMPLES, SECOND_SAMPLES = 60, 200
LOOK_WEIGHT = 0.7
FIT_WEIGHT, VIOLATION_WEIGHT, PRINT_WEIGHT, SEEN_WEIGHT, RIM_WEIGHT = 0.9, 1.0, 1.5, 0.3, 0.7
SEARCH_SAMPLES, SEARCH_STEPS_DEG = 100, (8.0, 4.0)
SAME_SHIFT, SAME_IOU = 0.25, 0.6
"""Poses nearer than this (in diameters), or whose boxes overlap so, are one proposal."""

SEEN_M, PATCH_PX = 0.02, 6


@dataclass(frozen=True)
class Effort:
    """How much is tried: windows, looks at them in all and in each, poses aligned in all and in each, places
    searched."""

    windows: int
    looks: int
    looks_each: int
    aligned: int
    aligned_each: int
    searched: int


EFFORTS = (Effort(28, 200, 15, 16, 2, 3), Effort(80, 700, 25, 48, 3, 8))
SURE = 1.35
"""A place with this score is the object's: nothing more is tried."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Where an object may be: a rough pose T_cam_obj (4, 4), the box of what is seen of it in the frame, and
    a score; support (N,): numbers of the patches of the picture that show it."""

    T_cam_obj: Float64
    box: Box
    score: float
    support: Int64


def propose(model: ReferenceModel, table: WindowTable, view: ClearView, count: int) -> list[Proposal]:
    """The `count` best different places of an object in a view, best first.

    A few windows are looked at first; all of them where that gives no place which is surely the object's."""
    with stage("windows"):
        windows = windows_of(view, model.diameter_m, table.views.span_m)
        order = promising(table, windows)
    proposals: list[Proposal] = []
    for effort in EFFORTS:
        if not proposals or proposals[0].score < SURE:
            proposals = _tried(model, table, view, windows[order[: effort.windows]], effort, count)
    return proposals


def _tried(
    model: ReferenceModel, table: WindowTable, view: ClearView, windows: Windows, effort: Effort, count: int
) -> list[Proposal]:
    with stage("look"):
        looks = look(table, windows, view.crop.camera, effort.looks, effort.looks_each)
    if not len(looks.poses):
        return []
    region = view.region(model.diameter_m)
    with stage("first"):
        rated = evidence(score_many(model, region, looks.poses, FIRST_SAMPLES)) + LOOK_WEIGHT * looks.scores
        first = looks.poses[_varied(looks.windows, rated, effort)]
    with stage("icp"):
        poses = align_in_view(model, view, first)
    with stage("second"):
        rated = _judged(model, view, region, poses)
    with stage("third"):
        best = _apart(model, poses, rated, effort.searched)
        found, _ = search(model, region, poses[best], SEARCH_STEPS_DEG, SEARCH_SAMPLES)
        rated = np.concatenate([_judged(model, view, region, found), rated])
        poses = np.concatenate([found, poses])
    with stage("thin"):
        return _thinned(model, view, poses, rated, count)


def _judged(model: ReferenceModel, view: ClearView, region: Region, poses: Float64) -> Float64:
    """Score (M,) of poses (M, 4, 4) on the picture."""
    terms = score_many(model, region, poses, SECOND_SAMPLES)
    return evidence(terms) - RIM_WEIGHT * rims(view, model_arrays(model), poses, SECOND_SAMPLES)


def evidence(terms: Float64) -> Float64:
    """Score (M,) of poses from the terms (M, 8) of the dense score without an outline."""
    fit, violation, color, seen = terms[:, 1], terms[:, 3], terms[:, 4], terms[:, 6]
    return np.asarray(
        FIT_WEIGHT * fit
        - VIOLATION_WEIGHT * violation
        + PRINT_WEIGHT * color
        + SEEN_WEIGHT * np.sqrt(np.clip(seen, 0.0, 1.0))
    )


def _varied(windows: Int64, rated: Float64, effort: Effort) -> Int64:
    """The best of looks (M,), at most so many of one window."""
    taken = np.zeros(windows.max() + 1, np.int64)
    chosen = []
    for k in np.argsort(-rated, kind="stable"):
        if taken[windows[k]] < effort.aligned_each:
            taken[windows[k]] += 1
            chosen.append(k)
            if len(chosen) == effort.aligned:
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
