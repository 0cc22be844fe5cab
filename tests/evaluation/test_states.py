"""Figures about states, on timelines small enough to count by hand.

A timeline has one letter a frame: T, S, L, N are TRACKING, SUSPECT, LOST, SEARCHING with a right pose (if
there is one); t and s the same with a wrong pose; '-' nothing published. The second string is the
visibility: '.' visible, 'p' partly occluded (10 to 30 % visible), 'g' gone.
"""

from __future__ import annotations

import pytest

from huepose.evaluation.states import Moment, StateReport, combined, find_losses, report

STATES = {"T": "TRACKING", "S": "SUSPECT", "L": "LOST", "N": "SEARCHING", "-": None}


def timeline(states: str, seen: str | None = None) -> list[Moment]:
    seen = seen or "." * len(states)
    assert len(seen) == len(states)
    return [
        Moment(i * 100_000_000, v == ".", v == "g", STATES[s.upper()], s in "TS")
        for i, (s, v) in enumerate(zip(states, seen, strict=True))
    ]


def judged(states: str, seen: str | None = None) -> StateReport:
    return report(timeline(states, seen))


def test_a_perfect_track() -> None:
    r = judged("TTTT")
    assert (r.coverage_tracking, r.false_tracking_frames, r.lost_frames) == (100.0, 0, 0)
    assert (r.acquired_after_s, r.confirmed_after_s, r.reacquired_after_s) == (0.0, 0.0, None)
    assert (r.declared_lost_after_frames, r.declared_suspect_after_frames) == (None, None)


def test_acquired_is_the_first_right_pose_and_confirmed_the_first_as_tracking() -> None:
    r = judged("NNtsSSTT")
    assert r.acquired_after_s == pytest.approx(0.4)
    assert r.confirmed_after_s == pytest.approx(0.6)
    assert r.false_tracking_frames == 1
    assert r.coverage_tracking == 100.0  # counted from the confirmation on


def test_times_count_from_the_first_visible_frame() -> None:
    r = judged("NNNST", "gpp..")
    assert r.acquired_after_s == 0.0
    assert r.confirmed_after_s == pytest.approx(0.1)


def test_coverage_is_zero_if_never_confirmed() -> None:
    r = judged("NSSS")
    assert (r.coverage_tracking, r.confirmed_after_s, r.never_confirmed) == (0.0, None, 1)
    assert r.acquired_after_s == pytest.approx(0.1)


def test_an_object_that_was_never_there_has_no_coverage() -> None:
    r = judged("NNTN", "gggg")
    assert r.coverage_tracking is None
    assert r.never_confirmed == 0
    assert r.false_tracking_frames == 0  # the pose is right, and the object gone for three frames only


def test_losing_a_visible_object_lowers_coverage() -> None:
    r = judged("TTTTLLLLST")
    assert r.coverage_tracking == pytest.approx(50.0)
    assert r.lost_frames == 4
    assert r.reacquired_after_s == pytest.approx(0.4)
    assert r.declared_lost_after_frames == 0


def test_losing_a_gone_object_does_not_lower_coverage() -> None:
    r = judged("TTTSSLLLLLSTT", "...gggggg....")
    # Counted: frames 0 to 2, and 11 and 12 after the next confirmation.
    assert r.coverage_tracking == 100.0
    assert r.lost_frames == 1  # visible again at 9, still LOST
    assert r.reacquired_after_s == pytest.approx(0.1)
    assert r.declared_suspect_after_frames == 0
    assert r.declared_lost_after_frames == 2


def test_coverage_counts_visible_frames_only() -> None:
    r = judged("TTSST", "..pp.")
    assert r.coverage_tracking == 100.0


def test_false_tracking_is_a_wrong_pose_or_more_than_five_gone_frames() -> None:
    assert judged("TttsT").false_tracking_frames == 2
    assert judged("TTTTTTTTT", ".gggggggg").false_tracking_frames == 3


def test_a_wrong_run_is_declared_when_it_is_published_as_suspect_then_lost() -> None:
    r = judged("TTttsssLL")
    assert r.declared_suspect_after_frames == 2
    assert r.declared_lost_after_frames == 5


def test_a_long_wrong_run_that_is_never_declared_counts_with_its_length() -> None:
    r = judged("TtttttttT")
    assert r.declared_lost_after_frames == 7
    assert r.declared_suspect_after_frames == 7


def test_a_short_wrong_run_needs_no_declaration() -> None:
    r = judged("TttT")
    assert (r.declared_suspect_after_frames, r.declared_lost_after_frames) == (None, None)
    assert r.reacquired_after_s == pytest.approx(0.2)


def test_losses_begin_only_after_support_and_skip_frames_without_a_message() -> None:
    assert [(x.start, x.end) for x in find_losses(timeline("NstTT--TssLT"))] == [(8, 11)]
    assert [(x.start, x.end) for x in find_losses(timeline("TT--", "..gg"))] == [(2, None)]


def test_frames_without_a_message_are_not_covered() -> None:
    assert judged("TT-T").coverage_tracking == 75.0


def test_frames_of_several_instances_add_up_and_times_are_the_worst() -> None:
    r = combined([judged("NTTT"), judged("NNTtLLLT"), judged("NNNN", "gggg")])
    assert r.frames == 16
    assert r.confirmed_after_s == pytest.approx(0.2)
    assert r.false_tracking_frames == 1
    assert (r.tracking_frames, r.coverable_frames) == (3 + 3, 3 + 6)
    assert r.declared_lost_after_frames == 1
