"""Boxes of a detector that works on pixels, assigned to the requests."""

import pytest

from huepose.perception.types import Detection
from huepose_services.boxes import SeenBoxes
from tests.services.one_cube import LEFT, MIDDLE, RIGHT, FakeDetector, answer, new, outlines, tracked


def _find(detector, *objects):
    return answer(SeenBoxes(outlines("cube"), detector), *objects)


def test_a_new_object_gets_the_best_boxes_and_no_more_than_wanted():
    detector = FakeDetector(
        Detection("cube", LEFT, 0.9), Detection("cube", RIGHT, 0.5), Detection("can", MIDDLE, 0.8)
    )
    found = _find(detector, new(), new("can", 2))
    assert [(d.request.object, d.box, d.score) for d in found] == [("cube", LEFT, 0.9), ("can", MIDDLE, 0.8)]
    assert [d.box for d in _find(detector, new(wanted=3))] == [LEFT, RIGHT]
    assert detector.asked[0] == ("cube", "can")


def test_a_tracked_instance_gets_the_box_at_its_prediction_and_a_new_one_another():
    detector = FakeDetector(Detection("cube", LEFT, 0.9), Detection("cube", MIDDLE, 0.4))
    found = _find(detector, tracked(), new(wanted=2))
    assert [(d.request.instance, d.box) for d in found] == [(3, MIDDLE), (None, LEFT)]


def test_a_new_instance_gets_no_box_of_another_one():
    detector = FakeDetector(Detection("cube", MIDDLE, 0.9), Detection("cube", LEFT, 0.4))
    assert [d.box for d in _find(detector, new(others=[tracked().prior]))] == [LEFT]


def test_an_object_may_also_get_a_box_where_a_look_alike_is_tracked():
    detector = FakeDetector(
        Detection("cube", MIDDLE, 0.4), Detection("can", MIDDLE, 0.9), Detection("can", LEFT, 0.3)
    )
    found = _find(detector, tracked(), new("can"))
    assert [(d.request.object, d.box) for d in found] == [("cube", MIDDLE), ("can", MIDDLE), ("can", LEFT)]


def test_a_waiting_object_gets_its_boxes():
    detector = FakeDetector(Detection("cube", LEFT, 0.9), Detection("can", RIGHT, 0.8), noticed=["can"])
    found = answer(SeenBoxes(outlines("cube"), detector), new(), waiting=[new("can")])
    assert [(d.request.object, d.box) for d in found] == [("cube", LEFT), ("can", RIGHT)]
    assert detector.asked == [("cube", "can")], "one call detects all"


def test_objects_without_a_detection_get_no_box():
    assert _find(FakeDetector(), new(), tracked()) == []


@pytest.mark.parametrize("score", [3.5, -1.0])
def test_scores_are_limited_to_the_range_of_the_message(score):
    (found,) = _find(FakeDetector(Detection("cube", LEFT, score)), new())
    assert found.score == min(max(score, 0.0), 1.0)
