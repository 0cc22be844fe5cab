"""What the loop asks for and when, on a clock that the test sets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.reinit import ObjectSlot, ReinitConfig, ReinitLoop
from huepose.support.errors import InputError

from .conftest import EPOCH, MS, asked, estimate, pose, result, track


def test_the_first_request_asks_for_objects_never_seen() -> None:
    loop = ReinitLoop(objects=[("mug", 2)])
    request = loop.tick(0, [])
    assert asked(request) == [("mug", None)]
    assert request is not None
    assert request.objects[0].wanted == 2
    assert request.objects[0].prior is None
    assert [(s.object, s.missing) for s in loop.searching()] == [("mug", 2)]


def test_a_request_for_a_missing_instance_names_the_sure_ones() -> None:
    loop = ReinitLoop(objects=[("mug", 4), ("can", 1)])
    sure, doubtful, lost = (
        track("mug", k, state, T=pose(0.1 * k))
        for k, state in enumerate((State.TRACKING, State.SUSPECT, State.LOST))
    )
    request = loop.tick(0, [sure, doubtful, lost, track("can")])
    assert request is not None
    first = request.objects[0]
    assert (first.object, first.instance, first.wanted) == ("mug", None, 2)
    (other,) = first.others
    np.testing.assert_array_equal(other.T_cam_obj, sure.T_cam_obj)
    assert other.stamp_ns == sure.stamp_ns
    assert not request.objects[1].others


def test_requests_come_at_the_period_and_one_at_a_time() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert loop.tick(250 * MS, []) is None, "one in flight"
    loop.answer(100 * MS, result(first, 0))
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    loop.answer(100 * MS, result(first, 0))
    assert loop.tick(199 * MS, []) is None, "not due yet"
    assert loop.tick(200 * MS, []) is not None


def test_ticks_that_do_not_fit_the_period_do_not_slow_requests_down() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    sent = []
    for ms in range(0, 3_000, 33):
        request = loop.tick(ms * MS, [])
        if request is not None:
            sent.append(ms)
            loop.answer((ms + 20) * MS, result(request, ms))
    assert len(sent) == 15, "five a second"
    assert min(np.diff(sent)) > 150


def test_missed_periods_are_not_made_up_for() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    loop.answer(900 * MS, result(loop.tick(0, []), 0))
    assert loop.tick(900 * MS, []) is not None
    loop.answer(950 * MS, result(2, 900))
    assert loop.tick(1_000 * MS, []) is None
    assert loop.tick(1_100 * MS, []) is not None


def test_lost_first_then_doubtful_then_stalest() -> None:
    loop = ReinitLoop(objects=[("a", 1), ("b", 1), ("c", 1), ("d", 1)])
    tracks = [track("a"), track("b", state=State.SUSPECT), track("c", state=State.LOST), track("d")]
    first = loop.tick(0, tracks)
    assert asked(first) == [("c", None), ("b", 0)]
    assert not any(one.known for one in first.objects), "it is not sure that they are these objects"
    loop.answer(50 * MS, result(first, 0, estimate("c")))
    tracks = [track("a"), track("b"), track("c", applied=1), track("d")]
    second = loop.tick(200 * MS, tracks)
    assert asked(second) == [("a", 0), ("d", 0)], "those never looked at come first"
    assert all(one.known for one in second.objects)


def test_absent_objects_do_not_starve_the_others() -> None:
    loop = ReinitLoop(objects=[("gone_1", 1), ("gone_2", 1), ("here", 1)])
    seen: list[int] = []
    for k in range(15):
        request = loop.tick(k * 200 * MS, [track("here", stamp_ms=k * 200)])
        names = [name for name, _ in asked(request)]
        assert "gone_1" in names or "gone_2" in names
        if "here" in names:
            seen.append(k)
        loop.answer(k * 200 * MS + 50 * MS, result(request, k * 200))
    assert len(seen) >= 2
    assert max(np.diff(seen)) <= 5, "looked at once per second"


def _looks_for_gone(
    loop: ReinitLoop, until_ms: int, seen: State = State.TRACKING, start_ms: int = 0
) -> list[int]:
    """The times in ms at which the loop looks for `gone`, which is never found. seen: its published state."""
    looks = []
    for ms in range(start_ms, until_ms, 200):
        request = loop.tick(ms * MS, [track("here", stamp_ms=ms), *([track("gone", 0, seen, stamp_ms=ms)])])
        if request is None:
            continue
        if ("gone", None) in asked(request):
            looks.append(ms)
        loop.answer((ms + 50) * MS, result(request, ms))
    return looks


def test_an_object_that_is_not_found_is_searched_once_per_second_after_a_while() -> None:
    loop = ReinitLoop(objects=[("gone", 1), ("here", 1)])
    looks = _looks_for_gone(loop, 12_000, State.LOST)
    gaps = np.diff(looks)
    eager = np.array(looks[1:]) <= 5_000
    assert set(gaps[eager]) == {200}
    assert set(gaps[~eager]) == {1_000}


def test_an_object_that_is_lost_again_or_reset_is_searched_at_once() -> None:
    loop = ReinitLoop(objects=[("gone", 1), ("here", 1)])
    assert _looks_for_gone(loop, 9_000, State.LOST)[-1] == 8_800
    assert _looks_for_gone(loop, 10_000, State.TRACKING, 9_000) == []
    assert _looks_for_gone(loop, 11_000, State.LOST, 10_000) == [10_000, 10_200, 10_400, 10_600, 10_800]
    _looks_for_gone(loop, 20_000, State.LOST, 11_000)
    loop.forget("gone", 20_000 * MS)
    assert _looks_for_gone(loop, 21_000, State.LOST, 20_000) == [20_000, 20_200, 20_400, 20_600, 20_800]


def test_a_first_uncertain_sighting_is_followed_up_at_once() -> None:
    loop = ReinitLoop(objects=[("gone", 1), ("here", 1)])
    (last,) = _looks_for_gone(loop, 9_000, State.LOST)[-1:]
    request = loop.tick((last + 1_000) * MS, [track("here", stamp_ms=last + 1_000)])
    assert ("gone", None) in asked(request)
    stamp = last + 1_000
    assert loop.answer((stamp + 50) * MS, result(request, stamp, estimate("gone", quality=0.5))) == []
    assert ("gone", None) in asked(loop.tick((stamp + 200) * MS, [track("here", stamp_ms=stamp + 200)]))


def _seen(
    loop: ReinitLoop, until_ms: int, *found: PoseEstimate, start_ms: int = 0, last_frame_ms: int = 0
) -> str:
    """A letter for each request: s if it says that all about the newest frame was answered, so that
    perception waits for the next frame; else n. No frame comes after `last_frame_ms`."""
    out = ""
    for ms in range(start_ms, until_ms, 50):
        stamp_ms = min(ms, last_frame_ms)
        request = loop.tick(ms * MS, [track("here", stamp_ms=stamp_ms)])
        if request is None:
            continue
        waits = request.seen == (EPOCH, round(stamp_ms / 33.3))
        out += "s" if waits else "n"
        if not waits:
            loop.answer((ms + 50) * MS, result(request, stamp_ms, *found))
    return out


def test_a_frame_about_which_all_was_answered_is_not_asked_about_again() -> None:
    """For a tracked object one answer is enough; missing ones are searched for everywhere in turn."""
    assert _seen(ReinitLoop(objects=[("here", 1)]), 2_000, last_frame_ms=2_000) == "n" * 10
    tracked, missing = ReinitLoop(objects=[("here", 1)]), ReinitLoop(objects=[("here", 1), ("gone", 1)])
    # A request that stays unanswered is repeated at its deadline, after 600 ms.
    agreed = estimate("here", instance=0)  # the tracker can apply it only with its next frame
    assert _seen(tracked, 6_000, agreed, last_frame_ms=400) == "nnn" + "s" * 9
    assert tracked.counters.given_up == 1
    assert _seen(missing, 3_000, last_frame_ms=400) == "nnnnn" + "s" * 4
    assert set(_seen(missing, 5_000, start_ms=3_000, last_frame_ms=5_000)) == {"n"}, "frames come again"


def test_a_request_that_is_held_while_no_frame_comes_has_not_expired() -> None:
    loop, agreed = ReinitLoop(objects=[("here", 1)]), estimate("here", instance=0)
    assert _seen(loop, 3_000, agreed, last_frame_ms=400).endswith("sss")
    assert (loop.counters.held, loop.counters.expired) == (3, 0)
    for ms in range(3_000, 5_000, 50):  # frames come again, and perception is dead
        loop.tick(ms * MS, [track("here", stamp_ms=ms)])
    assert (loop.counters.held, loop.counters.expired) == (3, 4)


@pytest.mark.parametrize(
    ("newest", "held"), [((EPOCH, 3), True), ((EPOCH, 4), False), ((EPOCH + 1, 0), False)]
)
def test_while_nothing_is_tracked_the_newest_frame_decides_whether_a_request_is_held(
    newest: tuple[int, int], held: bool
) -> None:
    loop = ReinitLoop(objects=[("gone", 1)])
    for ms in range(0, 600, 200):  # the object is searched for everywhere in turn
        loop.answer((ms + 50) * MS, result(loop.tick(ms * MS, []), 100))
    assert loop.tick(600 * MS, []).seen == (EPOCH, 3)
    loop.tick(1_200 * MS, [], newest)
    assert (loop.counters.held, loop.counters.expired) == (int(held), int(not held))


def test_an_answered_frame_is_asked_about_again_after_a_reset_or_a_lost_correction() -> None:
    loop = ReinitLoop(objects=[("here", 1), ("gone", 1)])
    assert _seen(loop, 1_500) == "nnnss"
    loop.forget("gone", 0)
    assert _seen(loop, 3_000, start_ms=1_800).startswith("nnns")
    loop = ReinitLoop(objects=[("here", 1), ("gone", 1)])
    found = estimate("gone", T=pose(0.3))
    answered = _seen(loop, 3_000, found)
    assert answered.endswith("ss")
    assert loop.counters.given_up == 0
    assert "n" in _seen(loop, 6_000, found, start_ms=3_000)
    assert loop.counters.given_up >= 1


def test_priors_carry_the_published_pose() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    velocity = np.array([0.1, 0, 0, 0, 0, 1.0])
    t = track(velocity=velocity, stamp_ms=40)
    request = loop.tick(0, [t])
    assert request is not None
    prior = request.objects[0].prior
    assert prior is not None
    assert prior.stamp_ns == 40 * MS
    np.testing.assert_array_equal(prior.velocity, velocity)
    ahead = prior.predicted(140 * MS, np.zeros(3))
    np.testing.assert_allclose(ahead[:3, 3], pose()[:3, 3] + [0.01, 0, 0], atol=1e-12)
    assert se3.rotation_angle(ahead, pose()) == pytest.approx(0.1)


def test_an_object_with_a_pending_correction_is_not_asked_for_again() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("cup", 1)])
    request = loop.tick(0, [])
    loop.answer(100 * MS, result(request, 10, estimate("mug")))
    assert asked(loop.tick(200 * MS, [])) == [("cup", None)]


def test_removed_objects_are_not_asked_for() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("cup", 1)])
    loop.remove("mug")
    request = loop.tick(0, [])
    assert asked(request) == [("cup", None)]
    assert loop.answer(MS, result(request, 0, estimate("mug"))) == []


def test_configuration_is_checked() -> None:
    with pytest.raises(InputError, match="deadline_ms"):
        ReinitConfig(deadline_ms=0)
    with pytest.raises(InputError, match="least_quality"):
        replace(ReinitConfig(), least_quality=0.95)
    with pytest.raises(InputError, match="max_instances"):
        ObjectSlot("mug", 0)


def test_a_track_that_is_most_likely_wrong_is_looked_for_elsewhere_now_and_then() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    looks = []
    for k in range(26):
        unlikely = track(state=State.SUSPECT, stamp_ms=k * 200, quality=0.05)
        request = loop.tick(k * 200 * MS, [unlikely])
        looks.append(asked(request))
        loop.answer(k * 200 * MS + 50 * MS, result(request, k * 200, estimate(quality=0.6, instance=0)))
    assert sum(("mug", None) in look for look in looks) == 5, "once a second, and not at once"
    assert all(("mug", 0) in look for look in looks)
    doubted = track(state=State.SUSPECT, stamp_ms=6000, quality=0.4)
    assert asked(loop.tick(6000 * MS, [doubted])) == [("mug", 0)], "this track may be right"


def test_missing_objects_that_are_not_asked_for_wait_in_the_same_request() -> None:
    loop = ReinitLoop(objects=[("a", 1), ("b", 1), ("c", 2), ("d", 1), ("e", 1)])
    tracks = [track("d", 0, State.TRACKING), track("c", 0, State.TRACKING, T=pose(0.3))]
    first = loop.tick(0, tracks)
    assert first is not None
    assert asked(first) == [("a", None), ("b", None)]
    assert [one.object for one in first.waiting] == ["c", "e"]
    assert first.deadline_ns == 600 * MS, "nobody may be listening yet"
    loop.answer(100 * MS, result(first, 0))
    request = loop.tick(200 * MS, tracks)
    assert request is not None
    assert asked(request) == [("c", None), ("e", None)], "in turn"
    assert [(one.object, one.instance, one.wanted) for one in request.waiting] == [
        ("a", None, 1),
        ("b", None, 1),
    ]
    assert request.deadline_ns - 200 * MS == (600 + 2 * 150) * MS, "it may take longer"
    loop.answer(300 * MS, result(request, 200))
    again = loop.tick(400 * MS, tracks)
    assert again is not None
    assert asked(again) == [("a", None), ("b", None)]
    assert [one.object for one in again.waiting] == ["c", "e"]
    (other,) = again.waiting[0].others
    np.testing.assert_array_equal(other.T_cam_obj, tracks[1].T_cam_obj)


def test_a_waiting_object_is_acquired_if_perception_finds_it() -> None:
    loop = ReinitLoop(objects=[("a", 1), ("b", 1), ("c", 1)])
    request = loop.tick(0, [])
    (correction,) = loop.answer(100 * MS, result(request, 0, estimate("c", quality=0.95)))
    assert (correction.object, correction.instance) == ("c", 0)
    again = loop.tick(200 * MS, [])
    assert again is not None
    assert [one.object for one in again.waiting] == [], "its correction is pending"


ABSENT = [(f"absent_{k:02d}", 1) for k in range(8)]


def _requests(
    loop: ReinitLoop, start_ms: int, until_ms: int, seen: State | None = None, places: Iterable[float] = ()
) -> list[list[str]]:
    """The names in each request. seen: the published state of the mug; places: where its next uncertain
    sightings are, along x."""
    out, sightings = [], iter(places)
    for ms in range(start_ms, until_ms, 200):
        tracks = [] if seen is None else [track("mug", state=seen, stamp_ms=ms)]
        request = loop.tick(ms * MS, tracks)
        names = [] if request is None else [name for name, _ in asked(request)]
        assert len(set(names)) == len(names)
        out.append(names)
        place = next(sightings, None) if "mug" in names else None
        found = [] if place is None else [estimate("mug", T=pose(place), quality=0.5)]
        if request is not None:
            loop.answer((ms + 50) * MS, result(request, ms, *found))
    return out


def test_an_uncertain_sighting_is_looked_at_once_more_before_objects_never_seen() -> None:
    loop = ReinitLoop(objects=[("mug", 1), *ABSENT])
    requests = _requests(loop, 0, 5_000, places=np.arange(100.0))
    looked = [k for k, names in enumerate(requests) if "mug" in names]
    gaps = np.diff(looked)
    first = int(gaps.argmin())
    assert set(gaps[first::2]) == {1}, "twice in a row"
    assert gaps[first + 1 :: 2].min() > 1, "then in turn, since nothing confirms it"
    again = [requests[k] for k in looked[first + 1 :: 2]]
    assert all(names[0] == "mug" and len(names) == 3 for names in again), "and no other object waits for it"


@pytest.mark.parametrize("state", [State.SUSPECT, State.LOST])
def test_an_object_that_just_became_uncertain_comes_before_those_never_seen(state: State) -> None:
    loop = ReinitLoop(objects=[("mug", 1), *ABSENT])
    _requests(loop, 0, 3_000, State.TRACKING)
    requests = _requests(loop, 3_000, 12_000, state)
    soon, later = requests[:25], requests[25:]
    assert all(names[:1] == ["mug"] for names in soon)
    for name, _ in ABSENT:
        assert sum(name in names for names in soon) >= 4, "which get their turns as before"
    assert 0.1 < np.mean(["mug" in names for names in later]) < 0.5, "after five seconds in turn"


def test_a_restarted_loop_looks_for_lost_objects_beside_those_never_looked_for() -> None:
    loop = ReinitLoop(objects=[("mug", 1), *ABSENT])
    requests = _requests(loop, 0, 1_000, State.LOST)
    assert all(names[0] == "mug" for names in requests)
    assert requests[1] == ["mug", "absent_02", "absent_03"]


@pytest.mark.parametrize("tracked", [1, 8])
def test_with_one_object_per_request_absent_objects_do_not_starve_the_others(tracked: int) -> None:
    loop = ReinitLoop(
        ReinitConfig(objects_per_request=1), [(f"here_{k}", 1) for k in range(tracked)] + ABSENT
    )
    looks: list[str] = []
    for ms in range(0, 30_000, 200):
        request = loop.tick(ms * MS, [track(f"here_{k}", stamp_ms=ms) for k in range(tracked)])
        looks += [name for name, _ in asked(request)]
        loop.answer((ms + 50) * MS, result(request, ms))
    last = looks[len(looks) // 2 :]
    here = [k for k, name in enumerate(last) if name.startswith("here")]
    assert set(last) == {*(f"here_{k}" for k in range(tracked)), *(name for name, _ in ABSENT)}
    assert set(np.diff(here)) == ({2} if tracked == 8 else {6}), "in turns, and no sooner than after a second"


def test_two_uncertain_sightings_in_one_answer_are_looked_at_once_more_too() -> None:
    loop, places = ReinitLoop(objects=[("mug", 2), *ABSENT]), iter(np.arange(100.0))
    looked = []
    for k in range(25):
        request = loop.tick(k * 200 * MS, [])
        again = ("mug", None) in asked(request)
        looked.append(again)
        found = [estimate("mug", T=pose(next(places)), quality=0.5) for _ in range(2 * again)]
        loop.answer((k * 200 + 50) * MS, result(request, k * 200, *found))
    out = "".join("m" if again else "." for again in looked)
    assert {len(run) for run in out.strip("m.").split(".") if run} <= {2}, out
    assert "mmm" not in out
    assert "mm" in out


def test_an_object_missing_for_long_is_looked_for_at_once_in_a_new_epoch() -> None:
    loop = ReinitLoop(objects=[("gone", 1), ("here", 1)])
    assert np.diff(_looks_for_gone(loop, 9_000, State.LOST))[-1] == 1_000, "its search rests"
    looks = []
    for ms in range(9_000, 11_000, 200):
        request = loop.tick(ms * MS, [track("here", stamp_ms=ms, epoch=EPOCH + 1)])
        looks.append(("gone", None) in asked(request))
        loop.answer((ms + 50) * MS, result(request, ms, epoch=EPOCH + 1))
    assert all(looks)
