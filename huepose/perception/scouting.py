"""Looks become proposals: poses are judged on the picture itself, brought onto the depth, and thinned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAREST_M
from huepose.judge.borders import continuation_many
from huepose.judge.region import ModelArrays, Region, model_arrays, nearest_view
from huepose.judge.terms import DEFAULT_WEIGHTS, score_many
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.perception.nearby import align_in_view
from huepose.perception.window_look import look, narrowed, promising
from huepose.perception.window_table import WindowTable
from huepose.perception.windows import Windows
from huepose.refine.coordinate_search import search
from huepose.support.jit import jit
from huepose.support.stages import stage

FIRST_SAMPLES, SECOND_SAMPLES = 60, 200
LOOK_WEIGHT = 7.0
"""Of a likeness beside the evidence of a pose: 0.03, by which the right view mostly leads, is worth 0.2."""

TEXTURE_WEIGHT, SEEN_WEIGHT, RIM_WEIGHT = 1.5, 0.3, 0.7
"""Of texture, visible share and outline; depth and free space count as in the dense score."""

SEARCH_SAMPLES, SEARCH_STEPS_DEG = 100, (8.0, 4.0)
SAME_SHIFT, SAME_IOU = 0.25, 0.6
"""Poses nearer than this (in diameters), or whose boxes overlap so, are one proposal."""

SAME_TURN, TURNS = np.radians(30.0), 2
"""So many poses at one place are looked at more closely, turned by more than what is between views: where the
handle of a plain mug points, its likeness tells better than its score does."""

SEEN_M, PATCH_PX, LEAST_SEEN = 0.02, 6, 5


@dataclass(frozen=True)
class Effort:
    """How much is tried: windows, those of them that are coded whatever others show, looks at them in all and
    in each, poses aligned in all and in each, places searched, and at how many of them the turns that look
    nearly the same are tried, too."""

    windows: int
    at_any_rate: int
    looks: int
    looks_each: int
    aligned: int
    aligned_each: int
    searched: int
    with_near_symmetries: int


EFFORTS = (Effort(20, 20, 36, 6, 6, 2, 2, 0), Effort(300, 20, 128, 6, 40, 3, 8, 2))
"""What is tried first, and what is tried where that gives no place which is surely the object's: nearly all
windows, since a camera's white balance may put the object's own ones last."""

SURE = 1.35
"""A place with this score is the object's: nothing more is tried."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Where an object may be: a rough pose T_cam_obj (4, 4), the box of what is seen of it in the frame, and
    a score; support (N,): numbers of the patches of the picture that show it; place: poses of one object with
    the same number are turned otherwise at one place."""

    T_cam_obj: Float64
    box: Box
    score: float
    support: Int64
    place: int = 0


def propose(
    model: ReferenceModel,
    table: WindowTable,
    view: ClearView,
    windows: Windows,
    count: int,
    efforts: Sequence[Effort] = EFFORTS,
    guessed: Callable[[], Float64] | None = None,
) -> list[Proposal]:
    """The poses of an object at its `count` best different places in a view; windows: of its size.

    `guessed`: gives poses (K, 4, 4) that keypoints agree on; `efforts`: what is tried by views. Each of these
    only until a place is surely the object's; keypoints after a first look by views, which costs less."""
    none = np.zeros((0, 4, 4)), np.zeros(0)
    by_keypoints, by_views = none, none
    if efforts:
        with stage("windows"):
            order = promising(table, windows)
    for step in (*efforts[:1], guessed, *efforts[1:]):
        if step is None or any((rated >= SURE).any() for _, rated in (by_keypoints, by_views)):
            continue
        if isinstance(step, Effort):
            by_views = _tried(model, table, view, windows, order[: step.windows], step)
        else:
            by_keypoints = _followed(model, view, step())
    poses = np.concatenate([by_keypoints[0], by_views[0]])
    rated = np.concatenate([by_keypoints[1], by_views[1]])
    with stage("thin"):
        return _thinned(model, view, poses, rated, count)


def _followed(model: ReferenceModel, view: ClearView, guesses: Float64) -> tuple[Float64, Float64]:
    """Guessed poses, as they are, on the depth and searched (M, 4, 4), and their scores (M,)."""
    if not len(guesses):
        return guesses, np.zeros(0)
    region = view.region(model.diameter_m)
    with stage("guesses"):
        poses = np.concatenate([guesses, align_in_view(model, view, guesses)])
        rated = _judged(model, view, region, poses)
        best = poses[_apart(model, poses, rated, len(guesses))]
        found, _ = search(model, region, best, SEARCH_STEPS_DEG, SEARCH_SAMPLES)
        rated = np.concatenate([_judged(model, view, region, found), rated])
        return np.concatenate([found, poses]), rated


def _tried(
    model: ReferenceModel,
    table: WindowTable,
    view: ClearView,
    windows: Windows,
    chosen: Int64,
    effort: Effort,
) -> tuple[Float64, Float64]:
    """Poses (M, 4, 4) at what the chosen windows (W,) show, and their scores (M,)."""
    chosen, alike = narrowed(table, windows, chosen, effort.at_any_rate)
    looks = look(table, windows, chosen, alike, view.crop.camera, effort.looks, effort.looks_each)
    if not len(looks.poses):
        return np.zeros((0, 4, 4)), np.zeros(0)
    region = view.region(model.diameter_m)
    with stage("first"):
        rated = (
            evidence(score_many(model, region, looks.poses, FIRST_SAMPLES)) + LOOK_WEIGHT * looks.likenesses
        )
        first = looks.poses[_varied(looks.windows, rated, effort)]
    with stage("icp"):
        poses = align_in_view(model, view, first)
    with stage("second"):
        rated = _judged(model, view, region, poses)
    with stage("third"):
        best = _apart(model, poses, rated, effort.searched)
        starts = np.concatenate(
            [
                poses[best],
                likeliest_near_symmetries(model, region, poses[best[: effort.with_near_symmetries]]),
            ]
        )
        found, _ = search(model, region, starts, SEARCH_STEPS_DEG, SEARCH_SAMPLES)
        rated = np.concatenate([_judged(model, view, region, found), rated])
        return np.concatenate([found, poses]), rated


def likeliest_near_symmetries(model: ReferenceModel, region: Region, poses: Float64) -> Float64:
    """The likeliest near-symmetric rotations of poses (N, 4, 4), as many as there are poses or fewer: a
    coarse view tells the faces of a box less well than it tells where it stands."""
    near_symmetric: Float64 = np.einsum("nij,mjk->nmik", poses, model.near_symmetries[1:]).reshape(-1, 4, 4)
    if not len(near_symmetric):
        return near_symmetric
    rated = evidence(score_many(model, region, near_symmetric, FIRST_SAMPLES))
    return np.asarray(near_symmetric[np.argsort(-rated, kind="stable")[: len(poses)]])


def _judged(model: ReferenceModel, view: ClearView, region: Region, poses: Float64) -> Float64:
    """Score (M,) of poses (M, 4, 4) on the picture."""
    terms = score_many(model, region, poses, SECOND_SAMPLES)
    return evidence(terms) - RIM_WEIGHT * continuation_many(
        model_arrays(model), view.crop.depth, view.clear, view.crop.camera, poses, SECOND_SAMPLES
    )


def evidence(terms: Float64) -> Float64:
    """Score (M,) of poses from the terms (M, 8) of the dense score without an outline."""
    fit, violation, color, seen = terms[:, 1], terms[:, 3], terms[:, 4], terms[:, 6]
    return np.asarray(
        DEFAULT_WEIGHTS.depth_fit * fit
        - DEFAULT_WEIGHTS.violation * violation
        + TEXTURE_WEIGHT * color
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
    """The best pose at each of `count` places, and the next ones there that are turned otherwise."""
    centres = poses[:, :3, :3] @ model.mesh.centre + poses[:, :3, 3]
    out: list[Proposal] = []
    firsts: list[int] = []
    for k in np.argsort(-rated, kind="stable"):
        away = np.linalg.norm(centres[firsts] - centres[k], axis=1)
        if (away < SAME_SHIFT * model.diameter_m).any():
            place = int(away.argmin())
            mine = [p for p in out if p.place == place]
            told = all(se3.rotation_angle(p.T_cam_obj, poses[k]) > SAME_TURN for p in mine)
            seen = seen_part(model, view, poses[k]) if told and 0 < len(mine) < TURNS else None
            if seen is not None:
                out.append(Proposal(poses[k], seen[0], float(rated[k]), seen[1], place))
        elif len(firsts) < count:
            seen = seen_part(model, view, poses[k])
            if seen is None or any(seen[0].iou(p.box) > SAME_IOU for p in out):
                continue
            out.append(Proposal(poses[k], seen[0], float(rated[k]), seen[1], len(firsts)))
            firsts.append(int(k))
    return out


def seen_part(
    model: ReferenceModel, view: ClearView, T_cam_obj: Float64, samples: int = 400
) -> tuple[Box, Int64] | None:
    """Bounds in the frame of the surface samples that agree with the depth, and the patches of the picture
    that they lie in; None where hardly any does."""
    camera = view.crop.camera
    bounds, patches = np.empty(4), np.empty(samples, np.int64)
    count = _seen(
        np.ascontiguousarray(T_cam_obj), model_arrays(model), view.crop.depth,
        camera.fx, camera.fy, camera.cx, camera.cy, bounds, patches,
    )  # fmt: skip
    if count < LEAST_SEEN:
        return None
    left, top, right, bottom = bounds
    box = Box(left + view.crop.x0, top + view.crop.y0, right - left + 1.0, bottom - top + 1.0)
    return box, np.unique(patches[:count])


@jit
def _seen(
    T: Float64,
    model: ModelArrays,
    depth: Float32,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    bounds: Float64,
    patches: Int64,
) -> int:
    """Fill bounds (4,) with the left, top, right and bottom pixel, patches (N,) with one number for each
    sample that agrees; returns how many do."""
    height, width = depth.shape
    view = nearest_view(T, model)
    first = model.offsets[view]
    last = min(model.offsets[view + 1], first + patches.shape[0])
    count = 0
    bounds[0], bounds[1], bounds[2], bounds[3] = 1e9, 1e9, -1e9, -1e9
    for k in range(first, last):
        p = model.points[model.visible[k]]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z < NEAREST_M:
            continue
        u = (T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]) / z * fx + cx
        v = (T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]) / z * fy + cy
        if u < -0.5 or v < -0.5 or u >= width - 0.5 or v >= height - 0.5:
            continue
        x, y = int(u + 0.5), int(v + 0.5)
        if depth[y, x] == 0.0 or abs(depth[y, x] - z) >= SEEN_M:
            continue
        bounds[0], bounds[1] = min(bounds[0], u), min(bounds[1], v)
        bounds[2], bounds[3] = max(bounds[2], u), max(bounds[3], v)
        patches[count] = (y // PATCH_PX) * width + x // PATCH_PX
        count += 1
    return count
