"""Proposes poses of an object in a view: rough poses from views and keypoints are scored, aligned with the
depth and refined. The best at a few places remain."""

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
from huepose.judge.terms import score_many
from huepose.judge.weights import DEFAULT_WEIGHTS
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import ClearView
from huepose.perception.nearby import align_in_view
from huepose.perception.window_table import WindowTable, most_similar_views, narrowed, promising
from huepose.perception.windows import Windows
from huepose.refine.coordinate_search import search
from huepose.support.jit import jit
from huepose.support.stages import stage

FIRST_SAMPLES, SECOND_SAMPLES = 60, 200
"""Surface samples used to score all rough poses, and to score aligned and refined ones."""

LIKENESS_WEIGHT = 7.0
"""Weight of a cosine of codes relative to `evidence`. The right view usually leads by 0.03, which is then
worth 0.2."""

TEXTURE_WEIGHT, VISIBLE_WEIGHT, RIM_WEIGHT = 1.5, 0.3, 0.7
"""Weights of texture, visible share and outline in the score. Depth fit and free-space violation have the
weights of the dense score."""

SEARCH_SAMPLES, SEARCH_STEPS_DEG = 100, (8.0, 4.0)
"""Surface samples and steps, degrees, of the coordinate search from the best poses."""

SAME_SHIFT, SAME_IOU = 0.25, 0.6
"""Poses whose centres are nearer than this (diameters), or whose boxes overlap by more than this IoU, are
at one place."""

SAME_ROTATION, ROTATIONS = np.radians(30.0), 2
"""Up to ROTATIONS poses of one place are kept if their rotations differ by more than SAME_ROTATION, the
spacing of views. For example, the codes tell better than the score where the handle of a plain mug
points."""

VISIBLE_M, VISIBLE_SAMPLES, LEAST_VISIBLE, PATCH_PX = 0.02, 400, 5, 6
"""A surface sample is visible if the measured depth agrees to VISIBLE_M (metres). Most samples that are
checked; fewest that must be visible; side of a patch of the support, pixels."""


@dataclass(frozen=True)
class Effort:
    """How much a search by views tries. windows: how many are considered; at_any_rate: how many of them are
    encoded even if no similar window is near; looks, looks_each: pairs of window and view, in all and per
    window; aligned, aligned_each: poses aligned with the depth, in all and per window; searched: places
    refined; with_near_symmetries: at how many of these the object's near-symmetric rotations are tried as
    well."""

    windows: int
    at_any_rate: int
    looks: int
    looks_each: int
    aligned: int
    aligned_each: int
    searched: int
    with_near_symmetries: int

    def at(self, places: int) -> Effort:
        """The same effort, with enough poses for this many places."""
        return replace(
            self,
            looks=max(self.looks, places * self.looks_each),
            aligned=max(self.aligned, places * self.aligned_each),
            searched=max(self.searched, places),
        )


EFFORTS = (Effort(20, 20, 36, 6, 6, 2, 2, 0), Effort(300, 20, 128, 6, 40, 3, 8, 2))
"""The first effort, and the second one, used if no place is certain after the first. The second takes
nearly all windows, because a camera's white balance may put the object's own windows last."""

SURE = 1.35
"""A place with this score or more is certainly the object's: the search ends."""

UNLIKE = 0.21
"""If no window has this likeness with a view, keypoints give no place that is believed
(docs/detection_measured.md, keypoints of a model)."""


@dataclass(frozen=True, eq=False)
class Found:
    """Rough poses (M, 4, 4) with scores `rated` (M,). likeness: the highest of a window and a view; 1 if
    none were compared."""

    poses: Float64
    rated: Float64
    likeness: float = 1.0

    @staticmethod
    def nothing() -> Found:
        """No pose."""
        return Found(np.zeros((0, 4, 4)), np.zeros(0))

    @property
    def sure(self) -> bool:
        """Whether one of the poses is certainly the object's."""
        return bool((self.rated >= SURE).any())


@dataclass(frozen=True, eq=False)
class Proposal:
    """A rough pose T_cam_obj (4, 4), the box of its visible part in the frame, and its score. support (N,):
    indices of the image patches that show it; place: its number, the same for poses of one object at one
    place."""

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
    """Poses of an object at its `count` best places in a view.

    Views are searched with the first effort, then with more. Keypoints are tried once: after the first
    search by views in which a window looks like the object but no place is certain. The search ends when a
    place is certain. If `efforts` lacks the last of EFFORTS, which considers nearly all windows, keypoints
    are also tried if no window looked like the object. windows: of the object's size; efforts: of the
    search by views; guessed: returns poses (K, 4, 4) from keypoints; several: how many instances are
    searched for."""
    by_views = by_keypoints = Found.nothing()
    if efforts:
        with stage("windows"):
            order = promising(table, windows)
            order = order[view.free(windows.pixels[order])]
    for effort in efforts:
        by_views = _from_views(model, table, view, windows, order[: effort.windows], effort.at(several))
        if guessed is not None and not by_views.sure and by_views.likeness >= UNLIKE:
            by_keypoints, guessed = _from_guesses(model, view, guessed()), None
        if by_views.sure or by_keypoints.sure:
            break
    if guessed is not None and not by_views.sure and len(efforts) < len(EFFORTS):
        by_keypoints = _from_guesses(model, view, guessed())
    poses = np.concatenate([by_keypoints.poses, by_views.poses])
    rated = np.concatenate([by_keypoints.rated, by_views.rated])
    with stage("thin"):
        return _thinned(model, view, poses, rated, count)


def proposals_from(model: ReferenceModel, view: ClearView, guesses: Float64, count: int) -> list[Proposal]:
    """Poses of an object at its `count` best places in a view, from guessed poses (K, 4, 4) alone."""
    found = _from_guesses(model, view, guesses)
    return _thinned(model, view, found.poses, found.rated, count)


def _from_guesses(model: ReferenceModel, view: ClearView, guesses: Float64) -> Found:
    """Guessed poses (K, 4, 4) as they are, the same aligned with the depth, and the best of these
    refined."""
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


def _from_views(
    model: ReferenceModel,
    table: WindowTable,
    view: ClearView,
    windows: Windows,
    chosen: Int64,
    effort: Effort,
) -> Found:
    """Poses from the chosen windows (W,), with one effort."""
    chosen, alike = narrowed(table, windows, chosen, effort.at_any_rate)
    looks = most_similar_views(
        table, windows, chosen, alike, view.crop.camera, effort.looks, effort.looks_each
    )
    if not len(looks.poses):
        return Found.nothing()
    region = view.region(model.diameter_m)
    with stage("first"):
        rated = (
            evidence(score_many(model, region, looks.poses, FIRST_SAMPLES))
            + LIKENESS_WEIGHT * looks.likenesses
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
    """The best-scored near-symmetric rotations of poses (N, 4, 4), at most N. A coarse view determines the
    position of a box better than which of its faces is visible."""
    near_symmetric = model.near_symmetric(poses)
    if not len(near_symmetric):
        return near_symmetric
    rated = evidence(score_many(model, region, near_symmetric, FIRST_SAMPLES))
    return np.asarray(near_symmetric[np.argsort(-rated, kind="stable")[: len(poses)]])


def _judged(model: ReferenceModel, view: ClearView, region: Region, poses: Float64) -> Float64:
    """Scores (M,) of poses (M, 4, 4): `evidence` minus a penalty for surfaces that continue beyond the
    outline."""
    terms = score_many(model, region, poses, SECOND_SAMPLES)
    return evidence(terms) - RIM_WEIGHT * continuation_many(
        model_arrays(model), view.crop.depth, view.clear, view.crop.camera, poses, SECOND_SAMPLES
    )


def evidence(terms: Float64) -> Float64:
    """Scores (M,) from the terms (M, 8) of the dense score, without the outline."""
    fit, violation, color, visible = terms[:, 1], terms[:, 3], terms[:, 4], terms[:, 6]
    return np.asarray(
        DEFAULT_WEIGHTS.depth_fit * fit
        - DEFAULT_WEIGHTS.violation * violation
        + TEXTURE_WEIGHT * color
        + VISIBLE_WEIGHT * np.sqrt(np.clip(visible, 0.0, 1.0))
    )


def _varied(windows: Int64, rated: Float64, effort: Effort) -> Int64:
    """Indices of the best-scored pairs of window and view: at most `effort.aligned`, and
    `effort.aligned_each` per window. windows, rated: (M,)."""
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
            if len(mine) < ROTATIONS and all(
                se3.rotation_angle(p.T_cam_obj, poses[k]) > SAME_ROTATION for p in mine
            ):
                visible = visible_part(model, view, poses[k])
                if visible is not None:
                    out.append(Proposal(poses[k], visible[0], float(rated[k]), visible[1], place))
        elif len(firsts) < count:
            visible = visible_part(model, view, poses[k])
            if visible is None or any(visible[0].iou(p.box) > SAME_IOU for p in out):
                continue
            out.append(Proposal(poses[k], visible[0], float(rated[k]), visible[1], len(firsts)))
            firsts.append(int(k))
    return out


def visible_part(model: ReferenceModel, view: ClearView, T_cam_obj: Float64) -> tuple[Box, Int64] | None:
    """Box in the frame around the surface samples that agree with the depth, and indices of the patches in
    which they lie; None if fewer than LEAST_VISIBLE agree."""
    depth = view.crop.depth
    (left, top, right, bottom), pixels = visible_pixels(
        model, depth, view.crop.camera, T_cam_obj, VISIBLE_SAMPLES
    )
    if len(pixels) < LEAST_VISIBLE:
        return None
    box = Box(left + view.crop.x0, top + view.crop.y0, right - left + 1.0, bottom - top + 1.0)
    y, x = np.divmod(pixels, depth.shape[1])
    return box, np.unique((y // PATCH_PX) * depth.shape[1] + x // PATCH_PX)


def visible_pixels(
    model: ReferenceModel, depth: Float32, camera: Camera, T_cam_obj: Float64, samples: int
) -> tuple[Float64, Int64]:
    """The surface samples visible in a pose (4, 4), at most `samples`, that agree with the depth (h, w).
    Returns left, top, right and bottom of their projections, and the pixel number (N,) of each, row by
    row."""
    bounds, pixels = np.array([1e9, 1e9, -1e9, -1e9]), np.empty(samples, np.int64)
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    count = _visible(T, model_arrays(model), depth, camera.lens, bounds, pixels)
    return bounds, pixels[:count]


@jit
def _visible(
    T: Float64, model: ModelArrays, depth: Float32, lens: Float64, bounds: Float64, pixels: Int64
) -> int:
    """Widen bounds (4,) by the samples that agree, fill in their pixel numbers (N,), and return how many
    there are."""
    height, width = depth.shape
    first, last = shown_range(T, model, pixels.shape[0])
    count = 0
    for k in range(first, last):
        u, v, z = projected(T, model.points, model.visible[k], lens)
        if z < NEAREST_M or u < -0.5 or v < -0.5 or u >= width - 0.5 or v >= height - 0.5:
            continue
        x, y = int(u + 0.5), int(v + 0.5)
        if depth[y, x] == 0.0 or abs(depth[y, x] - z) >= VISIBLE_M:
            continue
        bounds[0], bounds[1] = min(bounds[0], u), min(bounds[1], v)
        bounds[2], bounds[3] = max(bounds[2], u), max(bounds[3], v)
        pixels[count] = y * width + x
        count += 1
    return count
