"""Proposes poses of an object in a view: rough poses from views and keypoints are scored, aligned with the
depth, refined and reduced to the best at a few places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAREST_M, Camera
from huepose.judge.borders import continuation_many
from huepose.judge.kernel_arrays import ModelArrays, model_arrays, projected, shown_range
from huepose.judge.region import Region
from huepose.judge.terms import DEFAULT_WEIGHTS, score_many
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.perception.nearby import align_in_view
from huepose.perception.window_table import WindowTable, likest_views, narrowed, promising
from huepose.perception.windows import Windows
from huepose.refine.coordinate_search import search
from huepose.support.jit import jit
from huepose.support.stages import stage

FIRST_SAMPLES, SECOND_SAMPLES = 60, 200
"""Surface samples by which all rough poses are rated, and by which the refined ones are."""

LOOK_WEIGHT = 7.0
"""Weight of a cosine of codes against `evidence`: the right view mostly leads by 0.03, which is worth 0.2."""

TEXTURE_WEIGHT, SEEN_WEIGHT, RIM_WEIGHT = 1.5, 0.3, 0.7
"""Weights of texture, visible share and outline in the score; depth and free space as in the dense score."""

SEARCH_SAMPLES, SEARCH_STEPS_DEG = 100, (8.0, 4.0)
"""Surface samples and steps of the coordinate search from the best poses."""

SAME_SHIFT, SAME_IOU = 0.25, 0.6
"""Poses whose centres are nearer than this (diameters), or whose boxes overlap by this IoU, are one place."""

SAME_TURN, TURNS = np.radians(30.0), 2
"""Up to TURNS poses of one place are kept if they differ by more than SAME_TURN, the spacing of views: which
way a plain mug's handle points is told better by the codes than by the score."""

SEEN_M, SEEN_SAMPLES, LEAST_SEEN, PATCH_PX = 0.02, 400, 5, 6
"""A surface sample is seen where the depth agrees to SEEN_M; most samples that are asked, fewest that are
seen; side of a patch of the support."""


@dataclass(frozen=True)
class Effort:
    """How much a search by views tries. windows: considered; at_any_rate: coded even if no neighbour looks
    similar; looks, looks_each: pairs of window and view in all and per window; aligned, aligned_each: poses
    aligned with the depth in all and per window; searched: places refined; with_near_symmetries: at how many
    of these the object's near-symmetric rotations are tried as well."""

    windows: int
    at_any_rate: int
    looks: int
    looks_each: int
    aligned: int
    aligned_each: int
    searched: int
    with_near_symmetries: int

    def at(self, places: int) -> Effort:
        """The same with enough poses for so many places."""
        return replace(
            self,
            looks=max(self.looks, places * self.looks_each),
            aligned=max(self.aligned, places * self.aligned_each),
            searched=max(self.searched, places),
        )


EFFORTS = (Effort(20, 20, 36, 6, 6, 2, 2, 0), Effort(300, 20, 128, 6, 40, 3, 8, 2))
"""The first effort, and the second one if no place is sure after it. The second takes nearly all windows,
because a camera's white balance may order the object's own ones last."""

SURE = 1.35
"""A place with this score is surely the object's: the search ends."""

UNLIKE = 0.21
"""Where no window has this likeness with a view, keypoints give no place that is believed
(docs/detection_measured.md, keypoints of a model)."""


@dataclass(frozen=True, eq=False)
class Found:
    """Rough poses (M, 4, 4) with scores (M,). likeness: of the window and the view that are most alike; 1
    where none were compared."""

    poses: Float64
    rated: Float64
    likeness: float = 1.0

    @staticmethod
    def nothing() -> Found:
        """No pose."""
        return Found(np.zeros((0, 4, 4)), np.zeros(0))

    @property
    def sure(self) -> bool:
        """Whether one of the poses surely is the object's."""
        return bool((self.rated >= SURE).any())


@dataclass(frozen=True, eq=False)
class Proposal:
    """A rough pose T_cam_obj (4, 4), the box of the visible part in the frame, and a score. support (N,):
    indices of the picture's patches that show it; place: poses of an object at the same place have the same
    number."""

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
    several: int = 1,
) -> list[Proposal]:
    """The poses of an object at its `count` best places in a view. windows: of the object's size; several: so
    many instances of it are looked for.

    Views with the first effort, then with more; after the first of them in which a window looks like the
    object, keypoints; the search ends when a place is sure. Without the last of EFFORTS, which looks at all
    windows, what no window looked like is looked for by keypoints as well. guessed: returns poses (K, 4, 4)
    from keypoints; efforts: those of the search by views."""
    by_views = by_keypoints = Found.nothing()
    if efforts:
        with stage("windows"):
            order = promising(table, windows)
            order = order[view.free(windows.pixels[order])]
    for effort in efforts:
        by_views = _tried(model, table, view, windows, order[: effort.windows], effort.at(several))
        if guessed is not None and not by_views.sure and by_views.likeness >= UNLIKE:
            by_keypoints, guessed = _followed(model, view, guessed()), None
        if by_views.sure or by_keypoints.sure:
            break
    if guessed is not None and not by_views.sure and len(efforts) < len(EFFORTS):
        by_keypoints = _followed(model, view, guessed())
    poses = np.concatenate([by_keypoints.poses, by_views.poses])
    rated = np.concatenate([by_keypoints.rated, by_views.rated])
    with stage("thin"):
        return _thinned(model, view, poses, rated, count)


def proposals_from(model: ReferenceModel, view: ClearView, guesses: Float64, count: int) -> list[Proposal]:
    """The poses of an object at its `count` best places in a view, from guessed ones (K, 4, 4) alone."""
    found = _followed(model, view, guesses)
    return _thinned(model, view, found.poses, found.rated, count)


def _followed(model: ReferenceModel, view: ClearView, guesses: Float64) -> Found:
    """Poses from guessed ones (K, 4, 4): as they are, aligned, and refined."""
    if not len(guesses):
        return Found.nothing()
    region = view.region(model.diameter_m)
    with stage("guesses"):
        poses = np.concatenate([guesses, align_in_view(model, view, guesses)])
        rated = _judged(model, view, region, poses)
        best = poses[_apart(model, poses, rated, len(guesses))]
        found, _ = search(model, region, best, SEARCH_STEPS_DEG, SEARCH_SAMPLES)
        rated = np.concatenate([_judged(model, view, region, found), rated])
        return Found(np.concatenate([found, poses]), rated)


def _tried(
    model: ReferenceModel,
    table: WindowTable,
    view: ClearView,
    windows: Windows,
    chosen: Int64,
    effort: Effort,
) -> Found:
    """Poses from the chosen windows (W,), with one effort."""
    chosen, alike = narrowed(table, windows, chosen, effort.at_any_rate)
    looks = likest_views(table, windows, chosen, alike, view.crop.camera, effort.looks, effort.looks_each)
    if not len(looks.poses):
        return Found.nothing()
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
        return Found(np.concatenate([found, poses]), rated, float(looks.likenesses[0]))


def likeliest_near_symmetries(model: ReferenceModel, region: Region, poses: Float64) -> Float64:
    """The best-scored poses among near-symmetric rotations of poses (N, 4, 4), at most N: a coarse view tells
    a box's place better than which of its faces is seen."""
    near_symmetric = model.near_symmetric(poses)
    if not len(near_symmetric):
        return near_symmetric
    rated = evidence(score_many(model, region, near_symmetric, FIRST_SAMPLES))
    return np.asarray(near_symmetric[np.argsort(-rated, kind="stable")[: len(poses)]])


def _judged(model: ReferenceModel, view: ClearView, region: Region, poses: Float64) -> Float64:
    """Scores (M,) of poses (M, 4, 4): `evidence` less what continues beyond their outlines."""
    terms = score_many(model, region, poses, SECOND_SAMPLES)
    return evidence(terms) - RIM_WEIGHT * continuation_many(
        model_arrays(model), view.crop.depth, view.clear, view.crop.camera, poses, SECOND_SAMPLES
    )


def evidence(terms: Float64) -> Float64:
    """Scores (M,) from the terms (M, 8) of the dense score, without the outline."""
    fit, violation, color, seen = terms[:, 1], terms[:, 3], terms[:, 4], terms[:, 6]
    return np.asarray(
        DEFAULT_WEIGHTS.depth_fit * fit
        - DEFAULT_WEIGHTS.violation * violation
        + TEXTURE_WEIGHT * color
        + SEEN_WEIGHT * np.sqrt(np.clip(seen, 0.0, 1.0))
    )


def _varied(windows: Int64, rated: Float64, effort: Effort) -> Int64:
    """Indices of the best-scored looks, at most `effort.aligned_each` of one window. windows, rated: (M,)."""
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
    """Indices of the `count` best-scored of poses (M, 4, 4) whose centres are apart (greedy)."""
    away = _away(model, poses)
    chosen: list[int] = []
    for k in np.argsort(-rated, kind="stable"):
        if not chosen or away[k, chosen].min() >= 0.5 * SAME_SHIFT * model.diameter_m:
            chosen.append(int(k))
            if len(chosen) == count:
                break
    return np.array(chosen)


def _away(model: ReferenceModel, poses: Float64) -> Float64:
    """Distances (M, M) of the object's centres at poses (M, 4, 4), metres."""
    centres = poses[:, :3, :3] @ model.mesh.centre + poses[:, :3, 3]
    return np.asarray(np.linalg.norm(centres[:, None] - centres, axis=2))


def _thinned(
    model: ReferenceModel, view: ClearView, poses: Float64, rated: Float64, count: int
) -> list[Proposal]:
    """The best pose at each of `count` places, and at most one more there with another rotation."""
    away = _away(model, poses)
    out: list[Proposal] = []
    firsts: list[int] = []
    for k in np.argsort(-rated, kind="stable"):
        if firsts and away[k, firsts].min() < SAME_SHIFT * model.diameter_m:
            place = int(away[k, firsts].argmin())
            mine = [p for p in out if p.place == place]
            if len(mine) < TURNS and all(se3.rotation_angle(p.T_cam_obj, poses[k]) > SAME_TURN for p in mine):
                seen = seen_part(model, view, poses[k])
                if seen is not None:
                    out.append(Proposal(poses[k], seen[0], float(rated[k]), seen[1], place))
        elif len(firsts) < count:
            seen = seen_part(model, view, poses[k])
            if seen is None or any(seen[0].iou(p.box) > SAME_IOU for p in out):
                continue
            out.append(Proposal(poses[k], seen[0], float(rated[k]), seen[1], len(firsts)))
            firsts.append(int(k))
    return out


def seen_part(model: ReferenceModel, view: ClearView, T_cam_obj: Float64) -> tuple[Box, Int64] | None:
    """Box in the frame of the surface samples that agree with the depth, and indices of the patches in which
    they lie; None if fewer than LEAST_SEEN agree."""
    depth = view.crop.depth
    (left, top, right, bottom), pixels = seen_pixels(model, depth, view.crop.camera, T_cam_obj, SEEN_SAMPLES)
    if len(pixels) < LEAST_SEEN:
        return None
    box = Box(left + view.crop.x0, top + view.crop.y0, right - left + 1.0, bottom - top + 1.0)
    y, x = np.divmod(pixels, depth.shape[1])
    return box, np.unique((y // PATCH_PX) * depth.shape[1] + x // PATCH_PX)


def seen_pixels(
    model: ReferenceModel, depth: Float32, camera: Camera, T_cam_obj: Float64, samples: int
) -> tuple[Float64, Int64]:
    """Of at most `samples` surface samples that a pose (4, 4) shows, those that agree with the depth (h, w):
    the left, top, right and bottom of where they fall, and the number (N,) of the pixel of each, row by
    row."""
    bounds, pixels = np.array([1e9, 1e9, -1e9, -1e9]), np.empty(samples, np.int64)
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    count = _seen(T, model_arrays(model), depth, camera.lens, bounds, pixels)
    return bounds, pixels[:count]


@jit
def _seen(
    T: Float64, model: ModelArrays, depth: Float32, lens: Float64, bounds: Float64, pixels: Int64
) -> int:
    """Widen bounds (4,) by the samples that agree, fill in their pixels (N,); returns how many they are."""
    height, width = depth.shape
    first, last = shown_range(T, model, pixels.shape[0])
    count = 0
    for k in range(first, last):
        u, v, z = projected(T, model.points, model.visible[k], lens)
        if z < NEAREST_M or u < -0.5 or v < -0.5 or u >= width - 0.5 or v >= height - 0.5:
            continue
        x, y = int(u + 0.5), int(v + 0.5)
        if depth[y, x] == 0.0 or abs(depth[y, x] - z) >= SEEN_M:
            continue
        bounds[0], bounds[1] = min(bounds[0], u), min(bounds[1], v)
        bounds[2], bounds[3] = max(bounds[2], u), max(bounds[3], v)
        pixels[count] = y * width + x
        count += 1
    return count
