"""The log-odds of a pose by its terms in one frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.frame import features, log_odds
from huepose.judge.terms import NOTHING

IN_VIEW = replace(NOTHING, total=1.0, depth_fit=1.0, seen=0.9, outside=0.0, colored=0.9)


def test_an_object_of_one_colour_lacks_no_texture():
    plain, nearly = replace(IN_VIEW, contrast=0.0), replace(IN_VIEW, contrast=1e-6)
    assert log_odds(plain, None, 0.0) == pytest.approx(log_odds(nearly, None, 0.0), abs=1e-5)


def test_without_visible_colour_the_texture_may_be_missing():
    unseen = replace(IN_VIEW, contrast=0.0, colored=0.0)
    assert features(unseen, None, 0.0)["color"] == -1.0
    assert features(replace(IN_VIEW, contrast=40.0), None, 0.0)["color"] < -0.9


def test_a_red_object_is_no_green_one_in_red_light():
    """A warm lamp makes red half a natural logarithm stronger than green (12 units); no lamp makes it
    three."""
    usual = log_odds(replace(IN_VIEW, contrast=0.0), None, 0.0)
    warm = log_odds(replace(IN_VIEW, contrast=0.0, light_rg=12.0, light_yb=25.0), None, 0.0)
    other = log_odds(replace(IN_VIEW, contrast=0.0, light_rg=-76.0, light_yb=16.0), None, 0.0)
    assert warm == usual
    assert other < usual - 4.0
    dark = log_odds(replace(IN_VIEW, contrast=0.0, light_l=-76.0), None, 0.0)
    assert dark == usual, "a shadow makes no other colour"


def test_a_known_light_exposes_a_look_alike_of_another_colour():
    """In known light a plain pink object is 12 units from its green look-alike."""
    white, plain = np.zeros(3), replace(IN_VIEW, contrast=0.0)
    other = replace(plain, light_rg=-12.0)
    assert log_odds(other, 1.0, 0.0, white) < log_odds(plain, 1.0, 0.0, white) - 0.5
    assert log_odds(other, 1.0, 0.0) == log_odds(plain, 1.0, 0.0), "an unknown light may be red"


def test_plain_colour_does_not_outweigh_a_free_space_violation_of_a_fifth():
    right = replace(IN_VIEW, contrast=13.0, color=0.7, seen=0.9, through=0.02)
    wrong = replace(IN_VIEW, contrast=0.6, color=0.85, seen=0.65, through=0.2)
    assert log_odds(wrong, None, 0.0) < log_odds(right, None, 0.0) - 1.5
