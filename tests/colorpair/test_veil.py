"""A veil of light over an image: its strength, and what is found without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.colorpair.opponents import LINEAR, unveiled, veil
from huepose.estimation import Estimator, ObjectQuery
from huepose.geometry.frame import RgbdFrame
from huepose.perception.view_detector import ViewDetector

LIGHT = 0.12


def veiled(frame: RgbdFrame, light: float = LIGHT, lit: float = 1.0) -> RgbdFrame:
    """The frame at `lit` times its light, under a veil of white light of strength `light`."""
    table = np.abs(LINEAR[None] - ((1.0 - light) * lit * LINEAR + light)[:, None]).argmin(1).astype(np.uint8)
    return replace(frame, color=table[frame.color])


@pytest.fixture(scope="module")
def frame(box_frame) -> RgbdFrame:
    """A tea box, and an object in deep shadow."""
    color = box_frame.color.copy()
    color[:40, :40] = 3
    return replace(box_frame, color=color)


def test_an_image_with_something_dark_is_unchanged(frame) -> None:
    assert veil(frame.color) < 0.002
    assert unveiled(frame) is frame
    assert veil(veiled(frame).color) == pytest.approx(LIGHT, abs=0.004)


def test_an_all_white_image_is_unchanged(frame) -> None:
    white = replace(frame, color=np.full_like(frame.color, 255))
    assert unveiled(white) is white


def test_without_its_veil_an_image_has_its_colours_again(frame) -> None:
    again = unveiled(veiled(frame))
    assert veil(again.color) < 0.002
    assert again.depth is frame.depth
    # Linear light between two bytes: 0.003 where it is dark under the veil, 0.009 where it is bright.
    assert np.abs(LINEAR[again.color] - LINEAR[frame.color]).max() < 0.01


def test_detector_and_estimator_remove_the_veil(tea_box, frame) -> None:
    models, seen = {"tea_box": tea_box}, veiled(frame, lit=0.1)
    detector, estimator = ViewDetector(models), Estimator(models)
    (veiled_box, *_), (bare_box, *_) = (detector.detect(one, ["tea_box"]) for one in (seen, unveiled(seen)))
    assert veiled_box.score == bare_box.score
    query = ObjectQuery("tea_box", bare_box.box, searched=True)
    under, bare = (estimator.estimate(one, [query])[0] for one in (seen, unveiled(seen)))
    assert (under.present, under.quality) == (bare.present, bare.quality)
