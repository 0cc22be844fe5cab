"""Whether an object is there: shape, texture, and hues in the light that all of a frame has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.logistic import probabilities
from huepose.believe.presence import LIGHT_SPREAD, Light, Sight, light_of
from huepose.geometry import RgbdFrame, se3
from huepose.judge.hue import hue_log_ratio
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import clear_view
from huepose.perception.presence import agreeing_pixels, presences
from huepose.rendering.render import render

TakePicture = Callable[..., RgbdFrame]

WHITE = Light(np.zeros(2), 2.0)


def hue_evidence(sight: Sight, light: Light) -> float:
    return hue_log_ratio(sight.hues, light.shift, light.spread)


def seen(own: tuple[float, float], shown: tuple[float, float]) -> Sight:
    return Sight(0.5, 0.0, 0.0, 0.0, 0.0, 400, np.tile([1.0, *own, *shown], (20, 1)))


def test_the_same_strong_hue_says_more_than_the_same_grey_and_another_hue_speaks_against() -> None:
    red, grey, other = seen((45, 20), (45, 20)), seen((0, 0), (0, 0)), seen((45, 20), (5, 5))
    evidence = [hue_evidence(s, WHITE) for s in (red, grey, other)]
    assert evidence[0] > evidence[1] + 1.0 > 1.0
    assert evidence[2] < -1.0


def test_hues_are_compared_in_the_light_of_the_frame() -> None:
    yellow = Light(np.array([5.0, 20.0]), 2.0)
    shifted = seen((0, 0), (5, 20))
    assert hue_evidence(shifted, yellow) == pytest.approx(hue_evidence(seen((0, 0), (0, 0)), WHITE))
    assert hue_evidence(shifted, yellow) > hue_evidence(shifted, WHITE) + 1.0


def test_the_light_is_what_probable_places_agree_on() -> None:
    shifts = np.array([[10.0, 4.0], [11.0, 5.0], [9.0, 3.0], [-60.0, 50.0], [np.nan, np.nan]])
    light = light_of(np.array([4.0, 4.0, 4.0, -4.0, 9.0]), shifts)
    assert light.shift == pytest.approx([10.0, 4.0], abs=1.5)
    assert light.spread < 5.0
    unknown = light_of(np.zeros(0), np.zeros((0, 2)))
    assert unknown.shift.tolist() == [0.0, 0.0]
    assert unknown.spread == LIGHT_SPREAD


def test_an_object_is_there_even_turned_but_not_beside_itself_and_less_likely_without_its_texture(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    def chance(frame: RgbdFrame, T: np.ndarray) -> float:
        view = clear_view(frame, 0.3)
        assert view is not None
        return float(probabilities(presences(view, {"tea_box": tea_box}, [("tea_box", T)]))[0])

    frame = take_picture([(tea_box.mesh, standing)])
    beside = standing.copy()
    beside[0, 3] += 0.5 * tea_box.diameter_m
    half_turn = standing @ se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 90))
    assert chance(frame, standing) > 0.95
    assert chance(frame, beside) < 0.05
    assert chance(frame, half_turn) > 0.5
    assert chance(take_picture([(grey, standing)]), standing) < chance(frame, standing) - 0.2


def test_in_a_handful_of_pixels_nothing_is_believed(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    assert agreeing_pixels(tea_box, frame, standing) > 300
    far = replace(frame, camera=replace(frame.camera, fx=frame.camera.fx / 40.0, fy=frame.camera.fy / 40.0))
    speck = render([(tea_box.mesh, standing)], far.camera)
    pixels = int((speck.depth > 0).sum())
    assert 5 < pixels < 30
    far = replace(far, color=speck.color, depth=speck.depth.astype(np.float32))
    assert 3 <= agreeing_pixels(tea_box, far, standing) <= pixels + 5
    models, view = {"tea_box": tea_box}, clear_view(far, 0.3)
    if view is not None:  # else it was taken for noise
        assert probabilities(presences(view, models, [("tea_box", standing)]))[0] < 0.3
