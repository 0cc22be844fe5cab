"""An object found again is believed only as far as the image rules out another object or orientation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import Mesh, se3
from huepose.tracking import Correction, Tracker, Verdict

STICKER_BEHIND = se3.rotation_exp(np.array([np.pi / 2 + 0.3, 0.4, 0.0]))
GONE, BACK, END = 5, 15, 40


def _at(x: float) -> np.ndarray:
    return se3.make(STICKER_BEHIND, np.array([x, 0.0, 0.6]))


@pytest.fixture
def back_again(plain_box, shoot) -> tuple[Tracker, list[State]]:
    """A tracker of a plain box that was taken away and put back elsewhere, and its states since then."""
    tracker, states = Tracker({"plain_box": plain_box}), []
    for number in range(END):
        scene = [(plain_box.mesh, _at(-0.1 if number < GONE else 0.1))]
        frame = shoot([] if GONE <= number < BACK else scene, number)
        if number == 0:
            tracker.correct(Correction.first("plain_box", _at(-0.1), frame, 1.0))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    assert states[:GONE] == [State.TRACKING] * GONE
    return tracker, states[BACK:]


def test_the_usual_total_is_that_in_the_light_of_the_scene(plain_box, shoot) -> None:
    tracker, baselines = Tracker({"plain_box": plain_box}), []
    for number in range(3):
        frame = shoot([(plain_box.mesh, _at(0.0))], number)
        if number == 0:
            tracker.correct(Correction.first("plain_box", _at(0.0), frame, 1.0))
        tracker.step(frame)
        track = tracker._tracks["plain_box", 0]
        assert track.belief.usual.baseline is not None
        baselines.append(track.belief.usual.baseline)
    assert baselines == pytest.approx([track.terms.total] * 3, abs=0.1)


def test_a_plain_box_is_found_again_but_its_orientation_is_doubted(back_again, plain_box) -> None:
    tracker, states = back_again
    assert State.TRACKING not in states
    assert State.SUSPECT in states[: END - BACK - 5]
    (pose,) = tracker.poses()
    assert pose.T_cam_obj is not None
    centre = plain_box.mesh.centre
    assert se3.apply(pose.T_cam_obj, centre[None])[0] == pytest.approx(
        se3.apply(_at(0.1), centre[None])[0], abs=0.004
    )


@pytest.mark.parametrize(("asked_frame", "state"), [(GONE - 1, State.SUSPECT), (END - 1, State.TRACKING)])
def test_an_answer_from_before_the_loss_does_not_confirm_the_orientation_after_it(
    back_again, plain_box, shoot, asked_frame: int, state: State
) -> None:
    tracker, _ = back_again
    T = tracker.poses()[0].T_cam_obj
    frame = shoot([(plain_box.mesh, _at(0.1))], asked_frame)
    agreed = replace(Correction.first("plain_box", T, frame, 0.95), verdict=Verdict.AGREE, seq=2)
    tracker.correct(agreed)
    for number in range(END, END + 3):
        (pose,) = tracker.step(shoot([(plain_box.mesh, T)], number))
    assert pose.state is state


@pytest.mark.parametrize(
    ("quality", "asked_frame", "state"),
    [(0.55, 11, State.SUSPECT), (0.96, 11, State.TRACKING), (0.55, 4, State.TRACKING)],
)
def test_the_first_answer_about_an_object_found_elsewhere_decides(
    tea_box, shoot, path, quality: float, asked_frame: int, state: State
) -> None:
    """But not a late answer about a frame from before it went out of view."""
    tracker, frames = Tracker({"tea_box": tea_box}), []
    here, there = path(0), path(0).copy()
    there[:3, 3] += (0.18, 0.03, 0.15)
    tracker.correct(Correction.first("tea_box", here, shoot([(tea_box.mesh, here)], 0), 1.0))
    for number in range(12):
        away = 5 <= number < 8
        frames.append(shoot([] if away else [(tea_box.mesh, here if number < 5 else there)], number))
        (pose,) = tracker.step(frames[-1])
    assert pose.state is State.TRACKING
    assert pose.T_cam_obj is not None
    assert pose.T_cam_obj[:3, 3] == pytest.approx(there[:3, 3], abs=0.004)
    said = Correction.first("tea_box", here if asked_frame < 5 else there, frames[asked_frame], quality)
    tracker.correct(replace(said, verdict=Verdict.AGREE, seq=2))
    (pose,) = tracker.step(shoot([(tea_box.mesh, there)], 12))
    assert pose.state is state


@pytest.mark.parametrize("other", [False, True])
def test_an_object_of_another_color_found_after_a_loss_is_doubted(plain_bracket, shoot, other: bool) -> None:
    """A part is taken away; seconds later a part of the same shape is there."""
    tracker, there, states, seq = Tracker({"plain_bracket": plain_bracket}), _at(0.1), [], 1
    known = plain_bracket.mesh
    hues = (0.6 * known.texture + 0.4 * known.texture[..., [1, 2, 0]]).astype(np.uint8)
    mesh = Mesh(known.vertices, known.faces, known.uv, hues) if other else known
    for number in (*range(13), *range(200, 226)):
        scene = [(known, _at(-0.1))] if number < 5 else [(mesh, there)] if number >= 200 else []
        frame = shoot(scene, number)
        if number == 0:
            tracker.correct(Correction.first("plain_bracket", _at(-0.1), frame, 1.0))
        if number >= 200 and number % 4 == 0:
            seq += 1
            said = Correction.first("plain_bracket", there, frame, 0.9 if seq == 2 else 0.6)
            verdict = Verdict.ACQUIRE if seq == 2 else Verdict.AGREE
            tracker.correct(replace(said, verdict=verdict, seq=seq))
        (pose,) = tracker.step(frame)
        states.append(pose.state)
    assert states[:5] == [State.TRACKING] * 5
    assert states[12] is State.LOST
    assert (State.TRACKING in states[13:]) is not other
    light = tracker._tracks["plain_bracket", 0].belief.usual.sure_light
    assert light is not None
    assert float(np.abs(light).max()) < 8.0, "the light is from when the track was sure"


def test_identity_is_uncertain_after_a_search_finds_the_object_nearby(tea_box, shoot, path) -> None:
    """Another object of the same shape may be within reach of where this one went out of view."""
    tracker, here = Tracker({"tea_box": tea_box}), path(0)
    aside = here.copy()
    aside[0, 3] += 0.07
    tracker.correct(Correction.first("tea_box", here, shoot([(tea_box.mesh, here)], 0), 1.0))
    identities = []
    for number in range(9):
        scene = [(tea_box.mesh, here)] if number < 4 else [] if number < 6 else [(tea_box.mesh, aside)]
        (pose,) = tracker.step(shoot(scene, number))
        identities.append(tracker._tracks["tea_box", 0].belief.identity)
    assert pose.state is State.TRACKING
    assert pose.T_cam_obj is not None
    assert pose.T_cam_obj[:3, 3] == pytest.approx(aside[:3, 3], abs=0.004)
    assert (identities[5].lost, identities[-1].lost) == (0.0, identities[5].value)
