"""How objects are acquired, and searched for again."""

from __future__ import annotations

import pytest

from huepose.believe.state import State
from huepose.reinit import ObjectSlot, ReinitLoop
from huepose.tracking.types import Verdict

from .conftest import EPOCH, MS, asked, estimate, pose, result, track


def test_a_sure_estimate_acquires_and_instances_get_new_numbers() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(T=pose(-0.2)), estimate(T=pose(0.2))))
    assert [c.verdict for c in found] == [Verdict.ACQUIRE, Verdict.ACQUIRE]
    assert sorted(c.instance for c in found) == [0, 1]
    assert [c.seq for c in found] == [100 * MS, 100 * MS]
    assert all(c.frame_id == round(10 / 33.3) and c.epoch == EPOCH for c in found)


@pytest.mark.parametrize(("quality", "present", "taken"), [
    (0.6, 0.95, True), (0.6, 0.85, False), (0.6, None, False), (0.1, 0.95, False),
])  # fmt: skip
def test_one_estimate_is_enough_if_presence_is_certain(
    quality: float, present: float | None, taken: bool
) -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(quality=quality, present=present)))
    assert [(c.verdict, c.quality, c.present) for c in found] == (
        [(Verdict.ACQUIRE, quality, present)] if taken else []
    )


def test_no_more_instances_than_wanted() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(T=pose(-0.2)), estimate(T=pose(0.2))))
    assert len(found) == 1
    assert loop.counters.rejected == 1


@pytest.mark.parametrize(("most", "searched"), [(1, False), (2, True)])
def test_a_lost_instance_is_searched_for_only_if_there_may_be_so_many(most: int, searched: bool) -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    both = [track(), track(instance=1, T=pose(0.3))]
    loop.answer(1, result(loop.tick(0, both), 0))
    loop.add(ObjectSlot("mug", most))
    request = loop.tick(400 * MS, [track(stamp_ms=400), track("mug", 1, State.LOST, stamp_ms=400)])
    assert (("mug", None) in asked(request)) == searched
    found = loop.answer(500 * MS, result(request, 400, estimate(T=pose(0.3))))
    assert [c.key for c in found] == ([("mug", 1)] if searched else [])


@pytest.mark.parametrize(("quality", "taken"), [(0.05, True), (0.4, False)])
def test_a_sure_estimate_elsewhere_replaces_a_track_that_is_most_likely_wrong(
    quality: float, taken: bool
) -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [track(T=pose(-0.2), state=State.SUSPECT, quality=quality)])
    found = loop.answer(100 * MS, result(request, 0, estimate(T=pose(0.2))))
    assert [(c.instance, c.verdict) for c in found] == ([(0, Verdict.ACQUIRE)] if taken else [])


def test_two_estimates_of_one_pose_are_one_instance() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(T=pose(0.2)), estimate(T=pose(0.201))))
    assert len(found) == 1


def test_an_unsure_estimate_waits_for_a_second_that_agrees() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    assert loop.answer(100 * MS, result(request, 10, estimate(quality=0.6, present=0.8))) == []
    assert loop.counters.unconfirmed == 1
    request = loop.tick(200 * MS, [])
    far = loop.answer(300 * MS, result(request, 210, estimate(T=pose(0.5), quality=0.6)))
    assert far == [], "somewhere else altogether"
    request = loop.tick(400 * MS, [])
    second = estimate(T=pose(0.01), quality=0.55, present=0.7)
    (found,) = loop.answer(500 * MS, result(request, 410, second))
    assert found.verdict is Verdict.ACQUIRE
    assert (found.quality, found.present) == (0.6, 0.8), "two answers from one viewpoint share their errors"


def test_improbable_estimates_are_never_used() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    for k in range(3):
        request = loop.tick(k * 200 * MS, [])
        bad = (estimate(quality=0.1), estimate(found=False, quality=0.0))
        assert loop.answer(k * 200 * MS + 50, result(request, k * 200, *bad)) == []
    assert loop.counters.rejected == 6


def test_an_object_that_is_searched_again_gets_a_new_number_and_no_old_answer() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert first is not None
    (sent,) = loop.answer(50 * MS, result(first, 20, estimate()))
    request = loop.tick(300 * MS, [track(stamp_ms=290, applied=sent.seq)])
    assert asked(request) == [("mug", 0)]
    # Numbers below 1 of this epoch are withdrawn: the caller passes no such track any more.
    assert loop.forget("mug", 310 * MS) == (EPOCH, 1)
    assert loop.repeats(10_000 * MS) == []
    # The pending answer was computed on a frame from before `forget`.
    assert request is not None
    assert loop.answer(350 * MS, result(request, 300, estimate())) == []
    again = loop.tick(600 * MS, [])
    assert asked(again) == [("mug", None)]
    assert again is not None
    (fresh,) = loop.answer(650 * MS, result(again, 610, estimate()))
    assert (fresh.instance, fresh.verdict) == (1, Verdict.ACQUIRE)


@pytest.mark.parametrize("restarted", [False, True])
def test_a_withdrawn_number_is_not_used_again_when_the_camera_is_opened_again(restarted: bool) -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert first is not None
    loop.answer(50 * MS, result(first, 20, estimate()))
    withdrawn = loop.forget("mug", 60 * MS)
    assert withdrawn == (EPOCH, 1)
    if restarted:  # the list of objects is all that a new loop knows
        loop = ReinitLoop(objects=[("mug", 1)])
        loop.begin_at("mug", withdrawn[1])
    request = loop.tick(600 * MS, [])
    assert request is not None
    (found,) = loop.answer(650 * MS, result(request, 610, estimate(), epoch=EPOCH + 1))
    assert (found.epoch, found.instance) == (EPOCH + 1, 1)


def test_pending_corrections_of_a_forgotten_object_are_withdrawn() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("jar", 1)])
    request = loop.tick(0, [])
    assert request is not None
    loop.answer(50 * MS, result(request, 20, estimate(), estimate("jar", pose(0.5))))
    assert loop.forget("mug", 60 * MS) == (EPOCH, 1)
    assert [c.object for c in loop.repeats(400 * MS)] == ["jar"]


def test_before_the_first_frame_no_number_is_withdrawn() -> None:
    assert ReinitLoop(objects=[("mug", 1)]).forget("mug") is None
