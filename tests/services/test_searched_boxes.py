"""The detector without weights searches for what has no pose, and takes predictions for the rest."""

import msgspec
import pytest

from huepose.geometry import Box
from huepose.perception.types import Detection
from huepose_services.boxes import SearchedBoxes
from tests.services.one_cube import LEFT, MIDDLE, RIGHT, Seer, answer, new, outlines, tracked


def _find(detector, *objects, waiting=()):
    return answer(SearchedBoxes(outlines("cube", "can"), detector), *objects, waiting=waiting)


def test_what_is_tracked_is_not_searched_for():
    detector = Seer(Detection("cube", LEFT, 0.9))
    (found,) = _find(detector, tracked())
    assert Box(*found.box).iou(MIDDLE.grown(0.08)) > 0.95
    assert detector.asked == []


def test_an_old_prediction_is_not_trusted():
    detector = Seer(Detection("cube", LEFT, 0.9))
    assert [d.box for d in _find(detector, tracked(age_s=2.0))] == [LEFT]


def test_what_has_no_pose_is_searched_for_away_from_what_has_one():
    detector = Seer(
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


def test_a_look_alike_that_is_tracked_does_not_hide_what_may_be_there_instead():
    detector = Seer(Detection("can", MIDDLE, 0.9), Detection("can", LEFT, 0.3))
    found = _find(detector, tracked(), new("can"))
    assert [(d.request.object, d.box) for d in found[1:]] == [("can", MIDDLE), ("can", LEFT)]


def test_a_new_instance_is_searched_for_beside_the_others():
    detector = Seer(Detection("cube", LEFT, 0.9))
    moving = msgspec.structs.replace(tracked(0.2).prior, velocity_linear=(1.0, 0.0, 0.0))
    moving = msgspec.structs.replace(moving, velocity_angular=(0.0, 0.0, 0.0))
    assert [d.box for d in _find(detector, new(others=[tracked().prior, moving]))] == [LEFT]
    places = [T[:3, 3].tolist() for T in detector.followed["cube"]]
    assert places == [[0.0, 0.0, 1.0], [pytest.approx(0.2), 0.0, 1.0]], "where they are in this frame"
    _find(detector, new("can"))
    assert not detector.followed


def test_what_waits_gets_boxes_where_it_is_noticed():
    seen = Detection("cube", LEFT, 0.9), Detection("can", RIGHT, 0.8), Detection("can", MIDDLE, 0.7)
    detector = Seer(*seen, noticed=["can"])
    found = _find(detector, new(), waiting=[new("can", 2), new("bowl")])
    assert [(d.request.object, d.request.wanted, d.box) for d in found] == [
        ("cube", 1, LEFT),
        ("can", 2, RIGHT),
        ("can", 2, MIDDLE),
    ]
    assert detector.waiting == [("can",)], "and what has no model here is not asked about"
    assert [d.request.object for d in _find(detector, waiting=[new("cube"), new("can")])] == ["can"]
    assert detector.thorough[-1] == [], "nobody's turn"
    _find(detector, tracked(), waiting=[new("can")])
    assert detector.waiting[-1] == ("can",), "also where all that is asked for is tracked"


def test_an_object_whose_model_is_not_here_yet_gets_nothing():
    detector = Seer(Detection("cube", LEFT, 0.9))
    assert _find(detector, new("bowl")) == []
    assert detector.asked == []


def test_two_new_ones_are_searched_with_all_effort_and_then_one_at_a_time_by_turns():
    detector = Seer()
    finder = SearchedBoxes(outlines("cube", "can", "bowl"), detector)
    for missing in (("cube", "can", "bowl"),) * 4 + (("cube",), ("cube", "bowl")):
        answer(finder, *(new(name) for name in missing))
    assert detector.thorough == [["cube", "can"], ["bowl"], ["cube"], ["can"], ["cube"], ["bowl"]]
