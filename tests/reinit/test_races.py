"""Every race of the re-initialisation loop, on a clock that the test turns."""

from __future__ import annotations

import numpy as np

from huepose.reinit import ObjectSlot, ReinitLoop
from huepose.tracking.types import State, Verdict

from .conftest import EPOCH, MS, asked, estimate, pose, result, track


def test_a_silent_chain_is_counted_and_asked_anew() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert loop.tick(599 * MS, []) is None
    second = loop.tick(600 * MS, [])
    assert first is not None
    assert second is not None
    assert second.number == first.number + 1
    assert loop.counters.expired == 1


def test_corrections_are_repeated_until_applied() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    sent = loop.answer(100 * MS, result(request, 10, estimate()))
    assert loop.repeats(200 * MS) == [], "sent a moment ago"
    again = loop.repeats(300 * MS)
    assert again == sent, "the very same correction, the same number"
    assert loop.counters.resent == 1
    loop.tick(400 * MS, [track(applied=1, stamp_ms=400)])
    assert loop.repeats(600 * MS) == []


def test_a_correction_that_nobody_applies_is_given_up() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    loop.answer(100 * MS, result(request, 10, estimate()))
    for k in range(1, 30):
        loop.tick(k * 100 * MS, [])
        loop.repeats(k * 100 * MS)
    assert loop.counters.given_up == 1
    assert loop.repeats(3000 * MS) == []
    request = loop.tick(4000 * MS, [])
    again = loop.answer(4100 * MS, result(request, 4010, estimate()))
    assert again[0].instance == 1, "the number of the instance that never came is not used again"


def test_a_result_for_an_object_just_lost_acquires_it_again() -> None:
    """Asked while it was tracked, answered when it is lost: the same instance, with the next number."""
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [track(applied=4)])
    assert asked(request) == [("mug", 0)]
    loop.tick(150 * MS, [track(state=State.LOST, applied=4, stamp_ms=150)])
    found = loop.answer(160 * MS, result(request, 0, estimate(instance=0, prior_score=1.9)))
    assert [(c.verdict, c.instance, c.seq) for c in found] == [(Verdict.ACQUIRE, 0, 5)]


def test_a_late_answer_counts_but_is_used() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    first = loop.tick(0, [])
    second = loop.tick(600 * MS, [])
    found = loop.answer(650 * MS, result(first, 10, estimate()))
    assert loop.counters.late == 1
    assert [c.verdict for c in found] == [Verdict.ACQUIRE]
    assert loop.tick(850 * MS, []) is None, "the second is still in flight"
    assert second is not None


def test_two_results_out_of_order_the_older_is_ignored() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    first = loop.tick(0, [track()])
    second = loop.tick(600 * MS, [track(stamp_ms=600)])
    newer = loop.answer(700 * MS, result(second, 610, estimate(T=pose(0.03), instance=0, prior_score=1.0)))
    assert [c.seq for c in newer] == [1]
    older = loop.answer(710 * MS, result(first, 10, estimate(T=pose(-0.03), instance=0, prior_score=1.0)))
    assert older == []


def test_a_new_epoch_voids_everything() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    loop.answer(100 * MS, result(request, 10, estimate()))
    loop.tick(150 * MS, [track(instance=0, stamp_ms=150, applied=1)])
    late = loop.tick(400 * MS, [track(instance=0, stamp_ms=400, applied=1)])
    # The camera was opened anew: the tracker publishes nothing, and perception sees the new epoch first.
    new = EPOCH + 1
    found = loop.answer(500 * MS, result(late, 480, estimate(instance=0), epoch=new))
    assert [(c.epoch, c.instance, c.seq, c.verdict) for c in found] == [(new, 0, 1, Verdict.ACQUIRE)]
    old = loop.answer(510 * MS, result(1, 450, estimate(), epoch=EPOCH))
    assert old == []
    assert loop.counters.wrong_epoch == 1
    loop.tick(600 * MS, [track(stamp_ms=440)])
    assert loop.searching()[0].missing == 1, "a pose of the old epoch is no track any more"


def test_two_instances_crossing_keep_their_numbers() -> None:
    """Both move towards each other and have passed; each estimate came from the other one's request."""
    to_right, to_left = np.array([0.5, 0, 0, 0, 0, 0]), np.array([-0.5, 0, 0, 0, 0, 0])
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2, 0.1)])
    tracks = [
        track(instance=0, T=pose(-0.03), velocity=to_right, stamp_ms=0),
        track(instance=1, T=pose(0.03), velocity=to_left, stamp_ms=0),
    ]
    request = loop.tick(0, tracks)
    assert asked(request) == [("mug", 0), ("mug", 1)]
    found = loop.answer(
        220 * MS,
        result(
            request,
            120,
            estimate(T=pose(-0.03), instance=0, prior_score=2.0),
            estimate(T=pose(0.03), instance=1, prior_score=2.0),
        ),
    )
    assert {c.instance: round(float(c.T_cam_obj[0, 3]), 3) for c in found} == {0: 0.03, 1: -0.03}
    assert all(c.verdict is Verdict.AGREE for c in found)


def test_a_loop_that_was_started_anew_counts_on_from_what_was_applied() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    request = loop.tick(0, [track(instance=3, applied=17)])
    found = loop.answer(
        MS,
        result(request, 0, estimate(instance=3, prior_score=2.0), estimate(T=pose(0.4))),
    )
    assert [(c.instance, c.seq, c.verdict) for c in found] == [
        (3, 18, Verdict.AGREE),
        (4, 1, Verdict.ACQUIRE),
    ]


def test_an_acquisition_that_the_tracker_cannot_use_is_not_waited_for() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    first = loop.tick(0, [])
    (sent,) = loop.answer(100 * MS, result(first, 0, estimate()))
    assert loop.tick(300 * MS, []) is None, "it may still come"
    again = loop.tick(510 * MS, [])
    assert asked(again) == [("mug", None)]
    (newer,) = loop.answer(600 * MS, result(again, 510, estimate(T=pose(0.2))))
    assert newer.instance == sent.instance, "the same one: it never was there"
    assert newer.seq > sent.seq
    assert [c.seq for c in loop.repeats(900 * MS)] == [newer.seq]
