"""Does an object suit the method? Its pose is estimated in rendered scenes with exact ground truth.

The scenes are those of `huepose.scenes.rendered`: the object on a table among clutter, in varied light, from
0.45 to 2 m away, with the noise of a colour and a stereo depth camera.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from huepose.datasets.boxes import disturbed
from huepose.datasets.types import VISIBLE
from huepose.drawing.canvas import Colour, paragraph
from huepose.drawing.contact_sheet import contact_sheet
from huepose.drawing.overlay import (
    STATE_COLOURS,
    draw_axes,
    draw_label,
    draw_mask_outline,
    draw_way_out,
    silhouette,
)
from huepose.drawing.shading import shaded
from huepose.estimation import Estimator, ObjectQuery
from huepose.evaluation.metrics import RECALL_FRACTION, add, adds
from huepose.evaluation.turned import advice, rotations_in_words
from huepose.geometry import Box, Camera, RgbdFrame, se3
from huepose.geometry.arrays import Float64, UInt8
from huepose.geometry.icosphere import look_at
from huepose.geometry.symmetry import nearest_alike
from huepose.model import ReferenceModel
from huepose.profiles import profile
from huepose.rendering.render import render
from huepose.scenes.rendered import RenderedFrame, SceneRanges, check_sizes, rendered_frame
from huepose.support.errors import InputError
from huepose.support.lengths import length
from huepose.support.progress import progress
from huepose.tracking.uncertainty import exact_within_m

Verdict = Literal["suits", "suits with limits", "does not suit"]

TRIALS = 16
"""Rendered frames of a self-test. If 15 of 16 are right, the 95 % interval is 72 to 99 %
(Wilson)."""

RANGES = SceneRanges(distance_m=(0.45, 2.0))

WELL, SOMETIMES = 0.9, 0.5
"""Shares of right poses from which an object suits, and from which it suits with limits: what a user would
call reliable, and what tracking can still confirm over several frames."""

NEAR_ENOUGH_M = 1.0
"""An object that can be TRACKING only nearer than this suits with limits: about a table in front of a
robot."""

LEAST_SURE = 0.2
"""If the share of poses that are right and TRACKING is less, an object does not suit, even if many are
right: a pipeline would seldom have a pose to act on."""

MOST_FALSE = 0.1
"""If the share of poses that are wrong and TRACKING is more, an object does not suit, even if all others are
right: a robot acts on these. One in 16 may be chance."""

NOTICEABLE = 2.3
"""CIELAB distance at which two colours can just be distinguished (Mahy, Van Eycken and Oosterlinck 1994)."""

TURNED_RAD = np.radians(20.0)
"""Rotation error from which the rotation of a pose is wrong. Equivalent rotations of a round object are up to
15 degrees apart, and a right pose is a few degrees off."""

FACING = 0.3
"""Least cosine between a normal and the line of sight at which a colour pair is drawn in a view."""

_TOO_LARGE = "Its reference model is made anyway. If it is smaller, its mesh has another unit (--unit)."

MOST_TRIES = 100
"""Largest number of rendered scenes in a row that hardly show the object; usually one in twenty does."""

RED = (235, 60, 50)
"""Colour of a pose that is TRACKING and wrong."""

BLUE = (40, 110, 255)
"""Colour of the true pose where no pose was found."""

VIEW_PX, CROP_PX = 220, 200
"""Side of a view of the object; twice the least side of the object's box in a crop, which is larger."""

STEP = 0.01
"""Least step of depth that is drawn as an edge in a view, as a share of the object's diameter."""

BESIDE, BEFORE = 0.55, 3.0
"""Largest distances of an object's origin from its centre at which its axes are drawn, in diameters: across
and along the line of sight."""

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
CAPTION = (
    "First the object from six sides. Its axes are drawn at its origin, or the way to it, and its colour "
    "pairs in pink. Then the rendered scenes and the estimates: state, quality, right or wrong, distance. "
    "Green: TRACKING and right; amber: SUSPECT, not to be acted on; red: TRACKING and wrong; blue: LOST, "
    "the true pose is drawn."
)


@dataclass(frozen=True, eq=False)
class Trial:
    """One estimate in a rendered frame. size_px: the object's diameter in the image; right: ADD under a
    tenth of the diameter, to the nearest equivalent pose, and the rotation is right; shape_right: ADD-S
    under a tenth of the diameter; turn: rotation vector (3,) about the object's axes, from the nearest
    equivalent pose to the estimate, if only the rotation is wrong, else None; crop: the image (H, W, 3)
    around the object with the estimated pose, or with the true pose if none was found."""

    distance_m: float
    size_px: float
    state: str
    quality: float
    right: bool
    shape_right: bool
    crop: UInt8
    turn: Float64 | None = None


@dataclass(frozen=True, eq=False)
class Suitability:
    """The result of the trials. right, tracking: shares of trials with a right pose, and with a right pose
    that is TRACKING; false_tracking: number of trials with a wrong pose that is TRACKING; turned: number of
    trials in which only the rotation is wrong; smallest_px: size from which the share WELL of the poses is
    right, None if there is no such size; reasons: what limits the object, in sentences."""

    verdict: Verdict
    right: float
    tracking: float
    false_tracking: int
    turned: int
    smallest_px: float | None
    reasons: tuple[str, ...]
    trials: tuple[Trial, ...]


def self_test(model: ReferenceModel, count: int = TRIALS, seed: int = 0) -> Suitability:
    """Estimate the object's pose in `count` rendered frames. Raises InputError for an object that is too
    large for the rendered table."""
    check_sizes({model.name: model.mesh}, _TOO_LARGE)
    estimator = Estimator({model.name: model}, profile("live").estimator)
    return suitability_of(model, list(_trials(model, estimator, count, seed)))


def _trials(model: ReferenceModel, estimator: Estimator, count: int, seed: int) -> Iterator[Trial]:
    numbers = itertools.count()
    for _ in progress(range(count), f"testing {model.name} in rendered scenes"):
        number, rendered, around = _next_visible(model, seed, numbers)
        labels = rendered.shot.labels
        T_true = labels.T_cam_obj[0]
        frame = RgbdFrame(rendered.shot.color, rendered.shot.depth, rendered.camera)
        box = disturbed(around, "perturbed", seed, model.name, number, 0, rendered.camera)
        answer = estimator.estimate(frame, [ObjectQuery(model.name, box)])[0]
        T = answer.T_cam_obj
        right, shape_right, turn = (False, False, None) if T is None else judge(model, T, T_true)
        distance_m = float(se3.apply(T_true, model.mesh.centre[None])[0, 2])
        falsely_sure = answer.state == "TRACKING" and not right
        color = BLUE if T is None else RED if falsely_sure else STATE_COLOURS.get(answer.state, RED)
        yield Trial(
            distance_m,
            rendered.camera.fx * model.diameter_m / distance_m,
            answer.state,
            answer.quality,
            right,
            shape_right,
            _crop(model, frame.color, rendered.camera, around, T_true if T is None else T, color),
            turn,
        )


def _next_visible(model: ReferenceModel, seed: int, numbers: Iterator[int]) -> tuple[int, RenderedFrame, Box]:
    """The next rendered frame in which the object is visible: its number, the frame, and the bounds of the
    visible pixels."""
    for number in itertools.islice(numbers, MOST_TRIES):
        rendered = rendered_frame({model.name: model.mesh}, seed, number, RANGES)
        around = Box.of_mask(rendered.shot.owner == 0)
        if around is not None and rendered.shot.labels.visib_fract[0] >= VISIBLE:
            return number, rendered, around
    raise InputError(
        f"mesh of '{model.name}'",
        found=f"{MOST_TRIES} rendered scenes in a row that hardly show it",
        expected="a surface that a camera sees",
        fix="Look at the mesh in a viewer.",
    )


def judge(model: ReferenceModel, T: Float64, T_true: Float64) -> tuple[bool, bool, Float64 | None]:
    """`right`, `shape_right` and `turn` of a pose (4, 4), as in `Trial`."""
    limit_m = RECALL_FRACTION * model.diameter_m
    nearest = nearest_alike(T_true, model.equivalents, T)
    turn = se3.rotation_log(nearest[:3, :3].T @ T[:3, :3])
    turned = float(np.linalg.norm(turn)) > TURNED_RAD
    near = add(model.eval_points, T, nearest) < limit_m
    shape_right = bool(adds(model.eval_points, T, T_true) < limit_m)
    # ADD alone does not suffice: it is small for a thin object that is rotated about its length.
    return bool(near and not turned), shape_right, turn if turned and shape_right else None


def suitability_of(model: ReferenceModel, trials: Sequence[Trial]) -> Suitability:
    """The verdict on an object from its trials, at least one."""
    right = np.array([t.right for t in trials], bool)
    sure = np.array([t.state == "TRACKING" for t in trials], bool)
    share, tracking = float(right.mean()), float((right & sure).mean())
    shape = float(np.mean([t.shape_right for t in trials]))
    reasons = []
    lab = model.surface.lab[0]
    contrast = float(np.sqrt(((lab - lab.mean(0)) ** 2).sum(1).mean()))
    plain = contrast < 2.0 * NOTICEABLE
    if plain:
        reasons.append(
            f"It is of one colour (its colours differ by {contrast:.1f} in CIELAB): only its shape "
            "determines its pose. Without a box, things of similar shape are taken for it."
        )
    turns = [t.turn for t in trials if t.turn is not None]
    if turns:
        reasons.append(
            f"{len(turns)} of {len(trials)} poses have the right position and a wrong rotation: "
            f"{rotations_in_words(turns)}. Seen from there, right and wrong look too similar.{advice(turns)}"
        )
    if len(model.equivalents) > 1:
        reasons.append(
            f"{len(model.equivalents)} rotations of it look the same: its pose has any of them, and "
            "counts as right."
        )
    smallest = _smallest(trials)
    if smallest is not None and smallest > min(t.size_px for t in trials):
        large, small = [[t.right for t in trials if (t.size_px >= smallest) is of] for of in (True, False)]
        reasons.append(
            f"It must be at least {smallest:.0f} pixels large, as it is up to "
            f"{trials[0].size_px * trials[0].distance_m / smallest:.1f} m with this camera: {sum(large)} of "
            f"{len(large)} poses are right there, and {sum(small)} of {len(small)} farther away."
        )
    if share >= SOMETIMES and tracking < LEAST_SURE:
        reasons.insert(
            0,
            f"In {int((right & sure).sum())} of {len(trials)} scenes its pose is right and TRACKING: "
            "a pipeline would seldom have a pose to act on.",
        )
    elif share >= SOMETIMES and tracking < SOMETIMES:
        reasons.append(
            "It is seldom TRACKING after a single frame: a pipeline needs several frames that agree, and "
            "takes longer to confirm it."
        )
    exact_m = exact_within_m(model.surface.points.astype(np.float64) - model.mesh.centre, model.diameter_m)
    tiny = exact_m < NEAR_ENOUGH_M
    if tiny:
        where = f"Farther away than {exact_m:.1f} m" if exact_m else "Wherever it is,"
        reasons.insert(
            0,
            f"It is small: the errors of the depth camera and of the mesh are large compared with its "
            f"{length(model.diameter_m)}. {where} a pipeline never calls a pose of it TRACKING.",
        )
    wrong = int((sure & ~right).sum())
    if wrong:
        said = f"In {wrong} of {len(trials)} scenes a wrong pose was TRACKING."
        reasons.insert(0, said)
    verdict: Verdict = "suits" if share >= WELL else "does not suit"
    if (plain or wrong or tiny or verdict != "suits") and max(share, shape) >= SOMETIMES:
        verdict = "suits with limits"
    if wrong > MOST_FALSE * len(trials) or tracking < LEAST_SURE or not exact_m:
        verdict = "does not suit"
    if verdict == "does not suit" and not reasons:
        reasons.append("Its pose is seldom right, alone or among other objects: look at the trials.")
    return Suitability(verdict, share, tracking, wrong, len(turns), smallest, tuple(reasons), tuple(trials))


def seen_in_part(found: Suitability, share: float) -> Suitability:
    """The verdict if only this share of the surface was seen when the model was made: the trials render the
    model, not the object, so they do not show the rest."""
    reason = (
        f"Only {100 * share:.0f} % of its surface was seen: from the other sides it will not be found, and "
        "the rendered scenes show this incomplete model, not the object."
    )
    verdict: Verdict = "suits with limits" if found.verdict == "suits" else found.verdict
    return replace(found, verdict=verdict, reasons=(reason, *found.reasons))


def _smallest(trials: Sequence[Trial]) -> float | None:
    """The smallest size such that the share WELL of the trials of this size or larger is right; None if
    there is none. If most of the smaller trials are right, too, the smallest size of all: then size is not
    the cause of wrong poses."""
    by_size = sorted(trials, key=lambda t: -t.size_px)
    right = np.array([t.right for t in by_size], bool)
    fits = np.flatnonzero(np.cumsum(right) / np.arange(1, len(right) + 1) >= WELL)
    if not len(fits):
        return None
    smaller = right[fits[-1] + 1 :]
    return by_size[-1 if len(smaller) and smaller.mean() > SOMETIMES else int(fits[-1])].size_px


def in_words(model: ReferenceModel, found: Suitability) -> str:
    """The result as lines of text. The first has the verdict and the shares; if wrong poses were TRACKING,
    their share comes first."""
    n = len(found.trials)
    size = " x ".join(f"{100 * s:.1f}" for s in np.ptp(model.mesh.vertices, axis=0).tolist())
    false = f"wrong and TRACKING in {100 * found.false_tracking / n:.0f} %"
    right, sure = f"right in {100 * found.right:.0f} %", f"right and TRACKING in {100 * found.tracking:.0f} %"
    turned = f"wrong rotation in {100 * found.turned / n:.0f} %"
    shares = f"{size} cm, {right} of {n} rendered scenes, {sure}; {turned}, {false}"
    if found.false_tracking:
        shares = f"{false} of {n} rendered scenes, and nothing shows that these are wrong; "
        shares += f"{right}, {sure}, {turned}; {size} cm"
    return "\n".join([f"{model.name} {found.verdict}: {shares}.", *found.reasons])


def sheet(model: ReferenceModel, found: Suitability) -> UInt8:
    """A page (H, W, 3): the verdict, the object from six sides with its colour pairs, and every trial."""
    views = [_view(model, k) for k in _sides(model)]
    pictures = [*(picture for picture, _ in views), *(t.crop for t in found.trials)]
    labels = [f"from {axis}: {text}" for axis, (_, text) in zip(AXES, views, strict=True)]
    for t in found.trials:
        wrong = "wrong" if t.turn is None else f"rotated {np.degrees(np.linalg.norm(t.turn)):.0f} deg"
        word = "right" if t.right else "no pose" if t.state == "LOST" else wrong
        labels.append(f"{t.state} {t.quality:.2f}, {word}, {t.distance_m:.1f} m")
    page = contact_sheet(pictures, 6, labels, (VIEW_PX, VIEW_PX))
    words = f"{in_words(model, found)}\n{CAPTION}"
    return np.vstack([paragraph(words, page.shape[1], 0.55), page])


def _sides(model: ReferenceModel) -> list[int]:
    """Indices of the model's views that are nearest to AXES."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    return [int(k) for k in np.argmax(axes @ model.templates.directions.T, axis=1)]


def _view(model: ReferenceModel, k: int) -> tuple[UInt8, str]:
    """The object rendered in view k with its colour pairs as dots, and the number of these pairs in words."""
    camera = Camera(8.0 * VIEW_PX, 8.0 * VIEW_PX, VIEW_PX / 2, VIEW_PX / 2, VIEW_PX, VIEW_PX)
    R = look_at(model.templates.directions[k])
    T = se3.make(R, np.array([0.0, 0.0, 9.0 * model.diameter_m]) - R @ model.mesh.centre)
    view = render([(model.mesh, T)], camera)
    pixel_m = 9.0 * model.diameter_m / camera.fx
    picture = shaded(view.color, view.depth, view.normals_cam, pixel_m, STEP * model.diameter_m)
    facing = -model.pairs.normals @ R[2] > FACING
    pixels = camera.project(se3.apply(T, model.pairs.points[facing]))
    picture = np.where(view.depth[..., None] > 0.0, picture, 235).astype(np.uint8)
    for u, v in np.rint(pixels[:: max(1, len(pixels) // 400)]).astype(int):
        picture[v.clip(0, VIEW_PX - 1), u.clip(0, VIEW_PX - 1)] = (255, 60, 200)
    return _with_origin(picture, camera, T, model), f"{int(facing.sum())} colour pairs"


def _with_origin(picture: UInt8, camera: Camera, T: Float64, model: ReferenceModel) -> UInt8:
    """The picture with the object's axes; with the direction and distance of the origin if it is too far
    away."""
    away = T[:3, 3] - se3.apply(T, model.mesh.centre[None])[0]
    far = f"origin {length(float(np.linalg.norm(away)))}"
    if np.linalg.norm(away[:2]) > BESIDE * model.diameter_m:
        return draw_way_out(picture, away[:2], f"{far} away")
    if abs(away[2]) > BEFORE * model.diameter_m:
        text = f"{far} {'behind' if away[2] > 0.0 else 'in front of'} it"
        return draw_label(picture, text, (0.0, VIEW_PX), (250, 250, 250))
    return draw_axes(picture, camera, T, 0.3 * model.diameter_m, letters=True)


def _crop(
    model: ReferenceModel, color: UInt8, camera: Camera, around: Box, T: Float64, line: Colour
) -> UInt8:
    color = draw_mask_outline(color, silhouette(model.mesh, T, camera), line, 1)
    side = max(around.w, around.h, CROP_PX / 2)
    x, y = around.x + around.w / 2 - 0.7 * side, around.y + around.h / 2 - 0.7 * side
    rows, columns = Box(x, y, 1.4 * side, 1.4 * side).slices(camera.width, camera.height)
    return color[rows, columns].copy()
