"""The detector `views` searches for objects without a pose, and uses predictions for the others."""

import msgspec
import pytest

from huepose.geometry import Box
from huepose.perception.types import Detection
from huepose_services.boxes import SearchedBoxes
from tests.services.one_cube import LEFT, MIDDLE, RIGHT, FakeDetector, answer, new, outlines, tracked


def _find(detector, *objects, waiting=()):
    return answer(SearchedBoxes(outlines("cube", "can"), detector), *objects, waiting=waiting)


def test_a_tracked_object_is_not_searched_for():
    detector = FakeDetector(Detection("cube", LEFT, 0.9))
    (found,) = _find(detector, tracked())
    assert Box(*found.box).iou(MIDDLE.grown(0.08)) > 0.95
    assert detector.asked == []


def test_an_old_prediction_is_not_used():
    detector = FakeDetector(Detection("cube", LEFT, 0.9))
    assert [d.box for d in _find(detector, tracked(age_s=2.0))] == [LEFT]


def test_instances_with_old_predictions_get_the_boxes_that_are_nearest_to_them():
    """A camera of 1 Hz: each prediction is a second old."""
    detector = FakeDetector(Detection("cube", LEFT, 0.9), Detection("cube", MIDDLE, 0.8))
    here = tracked(age_s=1.0)
    x = (LEFT.x - MIDDLE.x) / 500.0
    prior = msgspec.structs.replace(here.prior, translation=(x, 0.0, 1.0))
    beside = msgspec.structs.replace(here, instance=4, prior=prior)
    assert [d.box for d in _find(detector, beside, here)] == [LEFT, MIDDLE]
    assert [d.box for d in _find(detector, here)] == [MIDDLE], "not that of an instance that is not asked for"
    assert detector.wanted == [{"cube": 2}, {"cube": 1}]


def test_new_instances_are_not_searched_for_where_one_is_tracked():
    detector = FakeDetector(
        Detection("cube", MIDDLE, 0.9), Detection("cube", RIGHT, 0.5), Detection("can", LEFT, 0.8)
    )
    found = _find(detector, tracked(), new(), new("can"))
    assert [(d.request.instance, d.request.object) for d in found] == [
        (3, "cube"),
        (None, "cube"),
        (None, "can"),
    ]
    assert [d.box for d in found[1:]] == [RIGHT, LEFT]
    assert detector.asked == [("cube", "can")]


def test_an_object_is_also_searched_for_where_a_look_alike_is_tracked():
    detector = FakeDetector(Detection("can", MIDDLE, 0.9), Detection("can", LEFT, 0.3))
    found = _find(detector, tracked(), new("can"))
    assert [(d.request.object, d.box) for d in found[1:]] == [("can", MIDDLE), ("can", LEFT)]


def test_the_search_for_a_new_instance_gets_the_predicted_poses_of_the_others():
    detector = FakeDetector(Detection("cube", LEFT, 0.9))
    moving = msgspec.structs.replace(tracked(0.2).prior, velocity_linear=(1.0, 0.0, 0.0))
    moving = msgspec.structs.replace(moving, velocity_angular=(0.0, 0.0, 0.0))
    assert [d.box for d in _find(detector, new(others=[tracked().prior, moving]))] == [LEFT]
    positions = [T[:3, 3].tolist() for T in detector.followed["cube"]]
    assert positions == [[0.0, 0.0, 1.0], [pytest.approx(0.2), 0.0, 1.0]], "where they are in this frame"
    _find(detector, new("can"))
    assert not detector.followed


def test_a_waiting_object_gets_boxes_if_it_is_noticed():
    seen = Detection("cube", LEFT, 0.9), Detection("can", RIGHT, 0.8), Detection("can", MIDDLE, 0.7)
    detector = FakeDetector(*seen, noticed=["can"])
    found = _find(detector, new(), waiting=[new("can", 2), new("bowl")])
    assert [(d.request.object, d.request.wanted, d.box) for d in found] == [
        ("cube", 1, LEFT),
        ("can", 2, RIGHT),
        ("can", 2, MIDDLE),
    ]
    assert detector.waiting == [("can",)], "an object without a model is not searched for"
    assert [d.request.object for d in _find(detector, waiting=[new("cube"), new("can")])] == ["can"]
    assert detector.thorough[-1] == [], "no thorough search"
    _find(detector, tracked(), waiting=[new("can")])
    assert detector.waiting[-1] == ("can",), "also if all requested objects are tracked"


def test_an_object_without_a_model_gets_no_box():
    detector = FakeDetector(Detection("cube", LEFT, 0.9))
    assert _find(detector, new("bowl")) == []
    assert detector.asked == []


def test_two_new_objects_are_searched_thoroughly_and_then_one_at_a_time_in_turn():
    detector = FakeDetector()
    finder = SearchedBoxes(outlines("cube", "can", "bowl"), detector)
    for missing in (("cube", "can", "bowl"),) * 4 + (("cube",), ("cube", "bowl")):
        answer(finder, *(new(name) for name in missing))
    assert detector.thorough == [["cube", "can"], ["bowl"], ["cube"], ["can"], ["cube"], ["bowl"]]
