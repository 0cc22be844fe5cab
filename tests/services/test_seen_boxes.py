"""Boxes of a detector that looks at pixels, for those who asked."""

import pytest

from huepose.perception.types import Detection
from huepose_services.boxes import SeenBoxes
from tests.services.one_cube import LEFT, MIDDLE, RIGHT, Seer, answer, new, outlines, tracked


def _find(detector, *objects):
    return answer(SeenBoxes(outlines("cube"), detector), *objects)


def test_a_new_object_gets_the_best_boxes_and_no_more_than_wanted():
    detector = Seer(
        Detection("cube", LEFT, 0.9), Detection("cube", RIGHT, 0.5), Detection("can", MIDDLE, 0.8)
    )
    found = _find(detector, new(), new("can", 2))
    assert [(d.request.object, d.box, d.score) for d in found] == [("cube", LEFT, 0.9), ("can", MIDDLE, 0.8)]
    assert [d.box for d in _find(detector, new(wanted=3))] == [LEFT, RIGHT]
    assert detector.asked[0] == ("cube", "can")


def test_a_tracked_instance_gets_the_box_at_its_prediction_and_a_new_one_another():
    detector = Seer(Detection("cube", LEFT, 0.9), Detection("cube", MIDDLE, 0.4))
    found = _find(detector, tracked(), new(wanted=2))
    assert [(d.request.instance, d.box) for d in found] == [(3, MIDDLE), (None, LEFT)]


def test_a_new_instance_gets_no_box_of_another_one():
    detector = Seer(Detection("cube", MIDDLE, 0.9), Detection("cube", LEFT, 0.4))
    assert [d.box for d in _find(detector, new(others=[tracked().prior]))] == [LEFT]


def test_a_look_alike_that_is_tracked_does_not_hide_what_may_be_there_instead():
    detector = Seer(
        Detection("cube", MIDDLE, 0.4), Detection("can", MIDDLE, 0.9), Detection("can", LEFT, 0.3)
    )
    found = _find(detector, tracked(), new("can"))
    assert [(d.request.object, d.box) for d in found] == [("cube", MIDDLE), ("can", MIDDLE), ("can", LEFT)]


def test_what_waits_gets_what_is_seen_of_it():
    detector = Seer(Detection("cube", LEFT, 0.9), Detection("can", RIGHT, 0.8), noticed=["can"])
    found = answer(SeenBoxes(outlines("cube"), detector), new(), waiting=[new("can")])
    assert [(d.request.object, d.box) for d in found] == [("cube", LEFT), ("can", RIGHT)]
    assert detector.asked == [("cube", "can")], "one look sees all"


def test_what_is_not_seen_gets_nothing():
    assert _find(Seer(), new(), tracked()) == []


@pytest.mark.parametrize("score", [3.5, -1.0])
def test_scores_stay_on_the_scale_of_the_wire(score):
    (found,) = _find(Seer(Detection("cube", LEFT, score)), new())
    assert found.score == min(max(score, 0.0), 1.0)
