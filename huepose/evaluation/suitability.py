"""Does an object suit the method? Its pose is asked for in drawn scenes, where the truth is known.

The scenes are those of `huepose.scenes.rendered`: the object on a table among other things, in any light,
from 0.45 to 2 m away, with the noise of a colour and a stereo depth camera.
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
from huepose.evaluation.turned import turns_in_words, way_out
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
"""Drawn frames of a self-test: 15 right ones of 16 leave 72 to 99 % (Clopper-Pearson, 95 %)."""

RANGES = SceneRanges(distance_m=(0.45, 2.0))

WELL, SOMETIMES = 0.9, 0.5
"""Shares of right poses from which an object suits, and from which it suits with limits: what a user would
call reliable, and what tracking still confirms over several frames."""

NEAR_ENOUGH_M = 1.0
"""An object suits with limits that can only be TRACKING nearer than this: a table before a robot."""

LEAST_SURE = 0.2
"""Share of poses that are right and TRACKING under which an object does not suit, however many are right: a
pipeline would seldom have one to act on."""

MOST_FALSE = 0.1
"""Share of poses that are wrong and TRACKING above which an object does not suit, however many others are
right: those are acted on. One in 16 may be chance."""

NOTICEABLE = 2.3
"""CIELAB distance of two colours that are just told apart (Mahy, Van Eycken and Oosterlinck 1994)."""

TURNED_RAD = np.radians(20.0)
"""A pose is turned from which angle on. Those that look the same are up to 15 degrees apart where an object
is round, and a right pose is a few degrees off."""

FACING = 0.3
"""Cosine between a normal and the line of sight from which a colour pair is drawn in a view."""

_TOO_LARGE = "Its reference model is made all the same. If it is smaller, its mesh has another unit (--unit)."

MOST_HIDDEN = 100
"""After so many drawn scenes in a row that hardly show the object, none will: one in twenty is usual."""

RED = (235, 60, 50)
"""Of a pose that is TRACKING and wrong."""

BLUE = (40, 110, 255)
"""Of the true pose where there is no answer."""

VIEW_PX, CROP_PX = 220, 200
"""Side of a drawn view; twice the least side of an object in the middle of a crop, which is larger."""

STEP = 0.01
"""Share of an object's diameter by which a step in its surface is drawn in a view."""

BESIDE, BEFORE = 0.55, 3.0
"""Diameters from an object's middle up to which its origin is in view: across and along the line of sight."""

AXES = ("+x", "+y", "+z", "-x", "-y", "-z")
CAPTION = (
    "First the object from six sides. Its axes are drawn at its origin, or the way to it, and its colour "
    "pairs in pink. Then the drawn scenes and the answers: state, quality, whether it is right, distance. "
    "Green: TRACKING and right; amber: SUSPECT, not to be acted on; red: TRACKING and wrong; blue: LOST, "
    "drawn where it is."
)


@dataclass(frozen=True, eq=False)
class Trial:
    """One drawn question. size_px: the object's diameter in the picture; right: ADD under a tenth of the
    diameter, to the nearest of the poses that look the same, and not turned; shape_right: ADD-S under it;
    turn: rotation vector (3,) of the answer about the object's axes, from the nearest of these poses, where
    it is in the right place and turned; crop: the picture (H, W, 3) around it with the answer, or
    without one the truth."""

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
    """What the trials say. right, tracking: shares of the trials with a right pose, and with one published as
    TRACKING; false_tracking, turned: numbers of those with a wrong pose published as TRACKING, and with one
    that is in the right place and turned; smallest_px: size from which on WELL of the poses are right, None
    where none is; reasons: what limits it, in sentences."""

    verdict: Verdict
    right: float
    tracking: float
    false_tracking: int
    turned: int
    smallest_px: float | None
    reasons: tuple[str, ...]
    trials: tuple[Trial, ...]


def self_test(model: ReferenceModel, count: int = TRIALS, seed: int = 0) -> Suitability:
    """Ask for the object's pose in `count` drawn frames. Raises InputError for an object that is too large to
    stand on the drawn table."""
    check_sizes({model.name: model.mesh}, _TOO_LARGE)
    estimator = Estimator({model.name: model}, profile("live").estimator)
    return suitability_of(model, list(_trials(model, estimator, count, seed)))


def _trials(model: ReferenceModel, estimator: Estimator, count: int, seed: int) -> Iterator[Trial]:
    numbers = itertools.count()
    for _ in progress(range(count), f"trying {model.name} in drawn scenes"):
        number, drawn, around = _next_that_shows(model, seed, numbers)
        labels = drawn.shot.labels
        T_true = labels.T_cam_obj[0]
        frame = RgbdFrame(drawn.shot.color, drawn.shot.depth, drawn.camera)
        box = disturbed(around, "perturbed", seed, model.name, number, 0, drawn.camera)
        answer = estimator.estimate(frame, [ObjectQuery(model.name, box)])[0]
        T = answer.T_cam_obj
        right, shape_right, turn = (False, False, None) if T is None else judge(model, T, T_true)
        distance_m = float(se3.apply(T_true, model.mesh.centre[None])[0, 2])
        falsely_sure = answer.state == "TRACKING" and not right
        color = BLUE if T is None else RED if falsely_sure else STATE_COLOURS.get(answer.state, RED)
        yield Trial(
            distance_m,
            drawn.camera.fx * model.diameter_m / distance_m,
            answer.state,
            answer.quality,
            right,
            shape_right,
            _crop(model, frame.color, drawn.camera, around, T_true if T is None else T, color),
            turn,
        )


def _next_that_shows(model: ReferenceModel, seed: int, numbers: Iterator[int]) -> tuple[int, RenderedFrame, Box]:
    """The next drawn frame that shows enough of the object: its number, and the bounds of what is seen."""
    for number in itertools.islice(numbers, MOST_HIDDEN):
        drawn = rendered_frame({model.name: model.mesh}, seed, number, RANGES)
        around = Box.of_mask(drawn.shot.owner == 0)
        if around is not None and drawn.shot.labels.visib_fract[0] >= VISIBLE:
            return number, drawn, around
    raise InputError(
        f"mesh of '{model.name}'",
        found=f"{MOST_HIDDEN} drawn scenes, one after the other, that hardly show it",
        expected="a surface that a camera sees",
        fix="Look at the mesh in a viewer.",
    )


def judge(model: ReferenceModel, T: Float64, T_true: Float64) -> tuple[bool, bool, Float64 | None]:
    """Of a pose (4, 4), whether it and its shape are right, and its turn, as in `Trial`."""
    limit_m = RECALL_FRACTION * model.diameter_m
    nearest = nearest_alike(T_true, model.equivalents, T)
    turn = se3.rotation_log(nearest[:3, :3].T @ T[:3, :3])
    turned = float(np.linalg.norm(turn)) > TURNED_RAD
    near = add(model.eval_points, T, nearest) < limit_m
    shape_right = bool(adds(model.eval_points, T, T_true) < limit_m)
    # A thin thing that is turned about its length is near, too.
    return bool(near and not turned), shape_right, turn if turned and shape_right else None


def suitability_of(model: ReferenceModel, trials: Sequence[Trial]) -> Suitability:
    """The verdict on an object of which these trials, one at least, are known."""
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
            f"It is of one colour (its colours differ by {contrast:.1f} in CIELAB): only its shape tells its "
            "pose, and where no box says where it is, things of like shape are taken for it."
        )
    turns = [t.turn for t in trials if t.turn is not None]
    if turns:
        reasons.append(
            f"{len(turns)} of {len(trials)} answers are in the right place and turned: "
            f"{turns_in_words(turns)}. Seen from there it looks too much alike.{way_out(turns)}"
        )
    if len(model.equivalents) > 1:
        reasons.append(
            f"{len(model.equivalents)} rotations of it look the same: any of them is answered, and counts as "
            "right."
        )
    smallest = _smallest(trials)
    if smallest is not None and smallest > min(t.size_px for t in trials):
        large, small = [[t.right for t in trials if (t.size_px >= smallest) is of] for of in (True, False)]
        reasons.append(
            f"It has to be {smallest:.0f} pixels large, which it is up to "
            f"{trials[0].size_px * trials[0].distance_m / smallest:.1f} m with this camera: {sum(large)} of "
            f"{len(large)} answers are right there, and {sum(small)} of {len(small)} farther away."
        )
    if share >= SOMETIMES and tracking < LEAST_SURE:
        reasons.insert(
            0,
            f"In {int((right & sure).sum())} of {len(trials)} scenes its pose is right and sure (TRACKING): "
            "a pipeline would seldom have one to act on.",
        )
    elif share >= SOMETIMES and tracking < SOMETIMES:
        reasons.append(
            "One picture alone seldom makes it sure (TRACKING): a pipeline needs several that agree, and "
            "takes longer to confirm it."
        )
    exact_m = exact_within_m(model.surface.points.astype(np.float64) - model.mesh.centre, model.diameter_m)
    tiny = exact_m < NEAR_ENOUGH_M
    if tiny:
        where = f"Farther away than {exact_m:.1f} m" if exact_m else "Wherever it is,"
        reasons.insert(
            0,
            f"It is small: errors of the depth camera and of the mesh are a large part of its "
            f"{length(model.diameter_m)}. {where} a pipeline never calls a pose of it TRACKING.",
        )
    wrong = int((sure & ~right).sum())
    if wrong:
        said = f"In {wrong} of {len(trials)} scenes a wrong pose was taken as sure (TRACKING)."
        reasons.insert(0, said)
    verdict: Verdict = "suits" if share >= WELL else "does not suit"
    if (plain or wrong or tiny or verdict != "suits") and max(share, shape) >= SOMETIMES:
        verdict = "suits with limits"
    if wrong > MOST_FALSE * len(trials) or tracking < LEAST_SURE or not exact_m:
        verdict = "does not suit"
    if verdict == "does not suit" and not reasons:
        reasons.append("Its pose is seldom right, alone or among other things: look at the trials.")
    return Suitability(verdict, share, tracking, wrong, len(turns), smallest, tuple(reasons), tuple(trials))


def seen_in_part(found: Suitability, share: float) -> Suitability:
    """The verdict where only that share of the surface was seen when the model was made: the trials draw the
    model, and cannot know the rest."""
    reason = (
        f"Only {100 * share:.0f} % of its surface was seen: from the other sides it will not be found, and "
        "the drawn scenes show the model as it was made, not the object."
    )
    verdict: Verdict = "suits with limits" if found.verdict == "suits" else found.verdict
    return replace(found, verdict=verdict, reasons=(reason, *found.reasons))


def _smallest(trials: Sequence[Trial]) -> float | None:
    """The smallest size so that of the trials of that size and more WELL are right; the smallest of all where
    most of the smaller ones are right, too: then it is not the size that makes some wrong."""
    by_size = sorted(trials, key=lambda t: -t.size_px)
    right = np.array([t.right for t in by_size], bool)
    fits = np.flatnonzero(np.cumsum(right) / np.arange(1, len(right) + 1) >= WELL)
    if not len(fits):
        return None
    smaller = right[fits[-1] + 1 :]
    return by_size[-1 if len(smaller) and smaller.mean() > SOMETIMES else int(fits[-1])].size_px


def in_words(model: ReferenceModel, found: Suitability) -> str:
    """Some lines for people. The first is the verdict and its shares; what is wrong and TRACKING comes first,
    where something is."""
    n = len(found.trials)
    size = " x ".join(f"{100 * s:.1f}" for s in np.ptp(model.mesh.vertices, axis=0).tolist())
    false = f"wrong and TRACKING in {100 * found.false_tracking / n:.0f} %"
    right, sure = f"right in {100 * found.right:.0f} %", f"right and TRACKING in {100 * found.tracking:.0f} %"
    turned = f"turned in {100 * found.turned / n:.0f} %"
    shares = f"{size} cm, {right} of {n} drawn scenes, {sure}; {turned}, {false}"
    if found.false_tracking:
        shares = f"{false} of {n} drawn scenes, and nothing tells of those that they are wrong; "
        shares += f"{right}, {sure}, {turned}; {size} cm"
    return "\n".join([f"{model.name} {found.verdict}: {shares}.", *found.reasons])


def sheet(model: ReferenceModel, found: Suitability) -> UInt8:
    """A page (H, W, 3): the verdict, the object from six sides with its colour pairs, and every trial."""
    views = [_view(model, k) for k in _sides(model)]
    pictures = [*(picture for picture, _ in views), *(t.crop for t in found.trials)]
    labels = [f"from {axis}: {text}" for axis, (_, text) in zip(AXES, views, strict=True)]
    for t in found.trials:
        wrong = "wrong" if t.turn is None else f"turned {np.degrees(np.linalg.norm(t.turn)):.0f} deg"
        word = "right" if t.right else "no pose" if t.state == "LOST" else wrong
        labels.append(f"{t.state} {t.quality:.2f}, {word}, {t.distance_m:.1f} m")
    page = contact_sheet(pictures, 6, labels, (VIEW_PX, VIEW_PX))
    words = f"{in_words(model, found)}\n{CAPTION}"
    return np.vstack([paragraph(words, page.shape[1], 0.55), page])


def _sides(model: ReferenceModel) -> list[int]:
    """The views of the model that are nearest to AXES."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    return [int(k) for k in np.argmax(axes @ model.templates.directions.T, axis=1)]


def _view(model: ReferenceModel, k: int) -> tuple[UInt8, str]:
    """The object as seen from a view, its colour pairs as dots, and how many these are."""
    camera = Camera(8.0 * VIEW_PX, 8.0 * VIEW_PX, VIEW_PX / 2, VIEW_PX / 2, VIEW_PX, VIEW_PX)
    R = look_at(model.templates.directions[k])
    T = se3.make(R, np.array([0.0, 0.0, 9.0 * model.diameter_m]) - R @ model.mesh.centre)
    seen = render([(model.mesh, T)], camera)
    pixel_m = 9.0 * model.diameter_m / camera.fx
    picture = shaded(seen.color, seen.depth, seen.normals_cam, pixel_m, STEP * model.diameter_m)
    facing = -model.pairs.normals @ R[2] > FACING
    pixels = camera.project(se3.apply(T, model.pairs.points[facing]))
    picture = np.where(seen.depth[..., None] > 0.0, picture, 235).astype(np.uint8)
    for u, v in np.rint(pixels[:: max(1, len(pixels) // 400)]).astype(int):
        picture[v.clip(0, VIEW_PX - 1), u.clip(0, VIEW_PX - 1)] = (255, 60, 200)
    return _with_origin(picture, camera, T, model), f"{int(facing.sum())} colour pairs"


def _with_origin(picture: UInt8, camera: Camera, T: Float64, model: ReferenceModel) -> UInt8:
    """The axes, where they are in view; else where the origin is."""
    away = T[:3, 3] - se3.apply(T, model.mesh.centre[None])[0]
    far = f"origin {length(float(np.linalg.norm(away)))}"
    if np.linalg.norm(away[:2]) > BESIDE * model.diameter_m:
        return draw_way_out(picture, away[:2], f"{far} away")
    if abs(away[2]) > BEFORE * model.diameter_m:
        text = f"{far} {'behind' if away[2] > 0.0 else 'before'} it"
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
