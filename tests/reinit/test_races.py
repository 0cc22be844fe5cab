"""Every race of the re-initialisation loop, on a clock that the test sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.reinit import ObjectSlot, ReinitLoop
from huepose.reinit.loop import ADOPTED_BELOW
from huepose.reinit.newest_frame import MOST_ENDED, Began, NewestFrame
from huepose.tracking.types import Verdict

from .conftest import EPOCH, MS, asked, estimate, pose, result, track


def test_an_unanswered_request_is_counted_and_sent_again() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert loop.tick(599 * MS, []) is None
    second = loop.tick(600 * MS, [])
    assert first is not None
    assert second is not None
    assert second.number == first.number + 1
    assert loop.counters.expired == 1


def test_an_unheard_request_is_sent_again_as_soon_as_perception_begins() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    assert loop.tick(0, []) is not None
    assert loop.tick(100 * MS, []) is None
    loop.perception_begins()
    request = loop.tick(133 * MS, [])
    assert asked(request) == [("mug", None)]
    assert loop.tick(333 * MS, []) is None, "one in flight"
    (correction,) = loop.answer(400 * MS, result(request, 140, estimate()))
    assert correction.verdict is Verdict.ACQUIRE
    assert (loop.counters.late, loop.counters.expired) == (0, 0)


@pytest.mark.parametrize("answered", [False, True])
def test_before_the_first_answer_no_search_counts_as_failed(answered: bool) -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    for ms in range(0, 9_000, 600):
        request = loop.tick(ms * MS, [])
        if answered and request is not None:
            loop.answer((ms + 50) * MS, result(request, ms))
    loop.perception_begins()
    looks = []
    for ms in range(9_000, 11_000, 200):
        request = loop.tick(ms * MS, [])
        if request is not None:
            looks.append(ms)
            loop.answer((ms + 50) * MS, result(request, ms))
    assert len(looks) == (2 if answered else 10), "once a second, or in every request"


def test_corrections_are_repeated_until_applied() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    sent = loop.answer(100 * MS, result(request, 10, estimate()))
    assert loop.repeats(200 * MS) == [], "sent a moment ago"
    again = loop.repeats(300 * MS)
    assert again == sent, "the very same correction, the same number"
    assert loop.counters.resent == 1
    loop.tick(400 * MS, [track(applied=sent[0].seq, stamp_ms=400)])
    assert loop.repeats(600 * MS) == []


def test_a_correction_that_is_never_applied_is_given_up() -> None:
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
    """Asked while it was tracked, answered when it is lost: the same instance, with a later number."""
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [track(applied=4)])
    assert asked(request) == [("mug", 0)]
    loop.tick(150 * MS, [track(state=State.LOST, applied=4, stamp_ms=150)])
    found = loop.answer(160 * MS, result(request, 0, estimate(instance=0, prior_score=1.9)))
    assert [(c.verdict, c.instance) for c in found] == [(Verdict.ACQUIRE, 0)]
    assert found[0].seq > 4


def test_a_late_answer_is_counted_and_used() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    first = loop.tick(0, [])
    second = loop.tick(600 * MS, [])
    found = loop.answer(650 * MS, result(first, 10, estimate()))
    assert loop.counters.late == 1
    assert [c.verdict for c in found] == [Verdict.ACQUIRE]
    assert loop.tick(850 * MS, []) is None, "the second is still in flight"
    assert second is not None


def test_of_two_results_out_of_order_the_older_is_ignored() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    first = loop.tick(0, [track()])
    second = loop.tick(600 * MS, [track(stamp_ms=600)])
    newer = loop.answer(700 * MS, result(second, 610, estimate(T=pose(0.03), instance=0, prior_score=1.0)))
    assert [c.seq for c in newer] == [700 * MS]
    older = loop.answer(710 * MS, result(first, 10, estimate(T=pose(-0.03), instance=0, prior_score=1.0)))
    assert older == []


def test_a_new_epoch_voids_everything() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    loop.answer(100 * MS, result(request, 10, estimate()))
    loop.tick(150 * MS, [track(instance=0, stamp_ms=150, applied=1)])
    late = loop.tick(400 * MS, [track(instance=0, stamp_ms=400, applied=1)])
    # The camera was opened again: the tracker publishes nothing, and perception sees the new epoch first.
    new = EPOCH + 1
    found = loop.answer(500 * MS, result(late, 480, estimate(instance=0), epoch=new))
    assert [(c.epoch, c.instance, c.seq, c.verdict) for c in found] == [(new, 0, 500 * MS, Verdict.ACQUIRE)]
    old = loop.answer(510 * MS, result(1, 450, estimate(), epoch=EPOCH))
    assert old == []
    assert loop.counters.wrong_epoch == 1
    loop.tick(600 * MS, [track(stamp_ms=440)])
    assert loop.searching()[0].missing == 1, "a pose of the old epoch is no track any more"


def test_two_instances_crossing_keep_their_numbers() -> None:
    """They moved towards each other and have passed; each estimate answers the request for the other one."""
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


def test_a_restarted_loop_continues_with_the_published_instances() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    request = loop.tick(0, [track(instance=3, applied=17)])
    found = loop.answer(
        40 * MS, result(request, 0, estimate(instance=3, prior_score=2.0), estimate(T=pose(0.4)))
    )
    assert [(c.instance, c.seq, c.verdict) for c in found] == [
        (3, 40 * MS, Verdict.AGREE),
        (4, 40 * MS, Verdict.ACQUIRE),
    ]


def test_no_number_that_a_pose_says_moves_those_of_the_loop() -> None:
    """Poses with the highest correction and instance numbers that a message can have."""
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    forged = [track(instance=0, applied=2**63 - 1), track(instance=2**31 - 1, T=pose(0.9), applied=2**63 - 1)]
    for k in range(3):
        loop.tick(k * 250 * MS, forged)
    request = loop.tick(750 * MS, forged)
    found = loop.answer(
        800 * MS,
        result(request, 750, estimate(T=pose(0.02), instance=0, prior_score=1.0), estimate(T=pose(0.4))),
    )
    assert [(c.instance, c.seq) for c in found] == [(0, 800 * MS), (1, 800 * MS)]


def test_an_instance_that_the_loop_has_created_is_known_however_high_its_number() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    adopted = track(instance=ADOPTED_BELOW - 1)
    request = loop.tick(0, [adopted])
    (_, new) = loop.answer(
        50 * MS, result(request, 0, estimate(instance=0, prior_score=2.0), estimate(T=pose(0.4)))
    )
    assert new.instance == ADOPTED_BELOW
    assert loop.searching()[0].missing == 1
    loop.tick(100 * MS, [adopted, track(instance=ADOPTED_BELOW, T=pose(0.4), stamp_ms=100)])
    assert loop.searching() == []


def test_an_acquisition_that_the_tracker_cannot_use_is_not_waited_for() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    first = loop.tick(0, [])
    (sent,) = loop.answer(100 * MS, result(first, 0, estimate()))
    assert loop.tick(300 * MS, []) is None, "it may still come"
    again = loop.tick(510 * MS, [])
    assert asked(again) == [("mug", None)]
    (newer,) = loop.answer(600 * MS, result(again, 510, estimate(T=pose(0.2))))
    assert newer.instance == sent.instance, "the same number: that instance never existed"
    assert newer.seq > sent.seq
    assert [c.seq for c in loop.repeats(900 * MS)] == [newer.seq]


@pytest.mark.parametrize("age_ms", [40, 250])
def test_an_object_that_the_tracker_found_elsewhere_is_no_second_instance(age_ms: float) -> None:
    """The answer is about a frame in which it was lost, so no pose is known there."""
    loop = ReinitLoop(objects=[("mug", 2)])
    for ms in range(0, 1_000, 50):
        loop.tick(ms * MS, [track(stamp_ms=ms)])
    for ms in range(1_000, 2_000, 50):
        loop.tick(ms * MS, [track(state=State.LOST, stamp_ms=ms)])
    loop.tick(2_000 * MS, [track(T=pose(0.8), stamp_ms=2_000)])
    found = loop.answer(2_010 * MS, result(loop.counters.requests, 2_000 - age_ms, estimate(T=pose(0.8))))
    assert [(c.instance, c.verdict) for c in found] == [(0, Verdict.AGREE)]


def test_a_camera_clock_that_is_set_back_stops_nothing() -> None:
    """Frame numbers go on, while timestamps jump back by 60 s."""
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    before = replace(track(stamp_ms=100_000), frame_id=10)
    request = loop.tick(100_000 * MS, [before])
    agreed = replace(result(request, 100_000, estimate(instance=0)), frame_id=10)
    assert [c.verdict for c in loop.answer(100_050 * MS, agreed)] == [Verdict.AGREE]
    after = replace(track(T=pose(0.3), stamp_ms=40_000), frame_id=12)
    request = loop.tick(100_200 * MS, [after])
    assert loop.repeats(101_000 * MS) == [], "about a frame from before the jump"
    late = replace(result(request, 99_970, estimate(instance=0)), frame_id=9)
    assert loop.answer(100_220 * MS, late) == [], "from before the jump"
    assert (loop.counters.wrong_epoch, loop.counters.rejected) == (1, 0)
    loop.tick(100_900 * MS, [replace(track(T=pose(0.4), stamp_ms=40_700), frame_id=14)])
    now = replace(result(2, 40_350, estimate(T=pose(0.35))), frame_id=13)
    assert [c.verdict for c in loop.answer(100_950 * MS, now)] == [Verdict.AGREE], "between two new poses"


def test_a_new_epoch_counts_whatever_its_timestamps() -> None:
    """A camera that is opened again may have another clock; a pose of the previous epoch is still
    published."""
    loop, new = ReinitLoop(objects=[ObjectSlot("mug", 2)]), EPOCH + 1
    old = track(instance=1, stamp_ms=100_000)
    loop.answer(100_050 * MS, result(loop.tick(100_000 * MS, [old]), 100_000))
    for k in range(4):
        fresh = track(stamp_ms=40_000 + 200 * k, epoch=new)
        request = loop.tick((100_200 + 200 * k) * MS, [old, fresh])
        assert request is not None
        assert request.epoch == new
        assert [s.missing for s in loop.searching()] == [1]
        found = loop.answer(
            (100_250 + 200 * k) * MS,
            result(request, 40_000 + 200 * k, estimate(instance=0), epoch=new),
        )
        assert [(c.epoch, c.verdict) for c in found] == [(new, Verdict.AGREE)]
    assert loop.counters.wrong_epoch == 0


def test_an_epoch_that_has_ended_begins_again_only_with_a_later_frame() -> None:
    frame = NewestFrame()
    assert [frame.note(*it) for it in ((1, 5, 100), (1, 6, 133), (2, 0, 40))] == [
        Began.EPOCH,
        Began.NOTHING,
        Began.EPOCH,
    ]
    assert [frame.note(1, 6, 133), frame.note(1, 4, 67)] == [Began.NOTHING] * 2
    assert frame.note(1, 7, 166) is Began.EPOCH
    for epoch in range(3, 3 + 2 * MOST_ENDED):
        assert frame.note(epoch, 0, 0) is Began.EPOCH
    assert len(frame._ended) == MOST_ENDED


def test_no_frame_number_blocks_later_frames() -> None:
    """The highest number that a message can have, on a current frame and on an earlier one."""
    frame = NewestFrame()
    for stamp_ns, began in ((200, Began.NOTHING), (150, Began.CLOCK)):
        frame.note(1, 5, 199)
        assert frame.note(1, 2**63 - 1, stamp_ns) is began
        for k in range(3):
            assert frame.note(1, 6 + k, 233 + k) is Began.NOTHING
            assert frame.is_of(1, 6 + k, 233 + k)
        frame = NewestFrame()
