"""Places that several objects are proposed for."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Box
from huepose.perception.scouting import Proposal
from huepose.perception.view_detector import FALL, contested


def place(score: float, first: int, count: int = 10) -> Proposal:
    return Proposal(np.eye(4), Box(first, 0, count, 5), score, np.arange(first, first + count))


def test_a_place_that_another_object_explains_better_loses() -> None:
    box, on_box, alone = place(2.5, 0), place(1.1, 2), place(0.9, 50)
    out = contested({"box": [box], "marker": [on_box, alone]})
    assert out["box"] == [box]
    assert [p.support[0] for p in out["marker"]] == [50, 2]
    assert out["marker"][1].score == 1.1 - FALL


def test_places_of_about_the_same_score_and_places_beside_keep_their_scores() -> None:
    for other in (place(1.0, 0), place(0.2, 8)):
        out = contested({"box": [place(1.5, 0)], "can": [other]})
        assert out["can"] == [other]


def test_an_object_is_no_rival_of_its_own_places() -> None:
    both = [place(1.5, 0), place(0.9, 2)]
    assert contested({"box": both, "can": []}) == {"box": both, "can": []}
