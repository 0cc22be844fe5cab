"""Every race of the re-initialisation loop, on a clock that the test turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.reinit import ObjectSlot, PerceptionResult, ReinitConfig, ReinitLoop, Request
from huepose.support.errors import InputError
from huepose.tracking.types import State, TrackedPose, Verdict

MS = 1_000_000
EPOCH = 7


def pose(x: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([0, 0, np.radians(turn_deg)])), np.array([x, 0.0, 0.6]))


def track(
    object_name: str = "mug",
    instance: int = 0,
    state: State = State.TRACKING,
    T: np.ndarray | None = None,
    stamp_ms: float = 0.0,
    applied: int = 0,
    epoch: int = EPOCH,
    velocity: np.ndarray | None = None,
) -> TrackedPose:
    T = None if state is State.LOST else (pose() if T is None else T)
    covariance = None if T is None else np.diag([1e-6] * 3 + [1e-4] * 3)
    frame = round(stamp_ms / 33.3)
    return TrackedPose(
        object_name, instance, epoch, frame, round(stamp_ms * MS), state, T, velocity, 0.9, covariance,
        applied
    )  # fmt: skip


def estimate(
    object_name: str = "mug",
    T: np.ndarray | None = None,
    instance: int = -1,
    quality: float = 0.95,
    score: float = 2.0,
    prior_score: float | None = None,
    found: bool = True,
) -> PoseEstimate:
    return PoseEstimate(
        object_name, instance, found, (pose() if T is None else T) if found else None, quality, "TRACKING",
        score, 0.3, None, None, None, prior_score, None, (), 0.1,
    )  # fmt: skip


def result(
    request: Request | int, stamp_ms: float, *estimates: PoseEstimate, epoch: int = EPOCH
) -> PerceptionResult:
    number = request if isinstance(request, int) else request.number
    return PerceptionResult(number, epoch, round(stamp_ms / 33.3), round(stamp_ms * MS), estimates)


def asked(request: Request | None) -> list[tuple[str, int | None]]:
    assert request is not None
    return [(o.object, o.instance) for o in request.objects]


def test_first_request_asks_for_what_was_never_seen() -> None:
    loop = ReinitLoop(objects=[("mug", 2)])
    request = loop.tick(0, [])
    assert asked(request) == [("mug", None)]
    assert request is not None
    assert request.objects[0].wanted == 2
    assert request.objects[0].prior is None
    assert [(s.object, s.missing) for s in loop.searching()] == [("mug", 2)]


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


def test_a_silent_chain_is_counted_and_asked_anew() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert loop.tick(599 * MS, []) is None
    second = loop.tick(600 * MS, [])
    assert first is not None
    assert second is not None
    assert second.number == first.number + 1
    assert loop.counters.expired == 1


def test_lost_first_then_doubtful_then_stalest() -> None:
    loop = ReinitLoop(objects=[("a", 1), ("b", 1), ("c", 1), ("d", 1)])
    tracks = [track("a"), track("b", state=State.SUSPECT), track("c", state=State.LOST), track("d")]
    first = loop.tick(0, tracks)
    assert asked(first) == [("c", None), ("b", 0)]
    loop.answer(50 * MS, result(first, 0, estimate("c")))
    tracks = [track("a"), track("b"), track("c", applied=1), track("d")]
    second = loop.tick(200 * MS, tracks)
    assert asked(second) == [("a", 0), ("d", 0)], "never looked at before those that were"


def test_objects_that_are_nowhere_do_not_starve_the_others() -> None:
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
    assert max(np.diff(seen)) <= 5, "looked at every second"


def test_priors_carry_what_was_published() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    velocity = np.array([0.1, 0, 0, 0, 0, 1.0])
    t = track(velocity=velocity, stamp_ms=40)
    request = loop.tick(0, [t])
    assert request is not None
    prior = request.objects[0].prior
    assert prior is not None
    assert prior.stamp_ns == 40 * MS
    np.testing.assert_array_equal(prior.velocity, velocity)
    ahead = prior.predicted(140 * MS)
    np.testing.assert_allclose(ahead[:3, 3], pose()[:3, 3] + [0.01, 0, 0], atol=1e-12)
    assert se3.rotation_angle(ahead, pose()) == pytest.approx(0.1)


def test_a_sure_estimate_acquires_and_instances_get_new_numbers() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(T=pose(-0.2)), estimate(T=pose(0.2))))
    assert [c.verdict for c in found] == [Verdict.ACQUIRE, Verdict.ACQUIRE]
    assert sorted(c.instance for c in found) == [0, 1]
    assert [c.seq for c in found] == [1, 1]
    assert all(c.frame_id == round(10 / 33.3) and c.epoch == EPOCH for c in found)


def test_no_more_instances_than_wanted() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(T=pose(-0.2)), estimate(T=pose(0.2))))
    assert len(found) == 1
    assert loop.counters.rejected == 1


def test_the_same_sight_twice_is_one_instance() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2)])
    request = loop.tick(0, [])
    found = loop.answer(100 * MS, result(request, 10, estimate(T=pose(0.2)), estimate(T=pose(0.201))))
    assert len(found) == 1


def test_an_unsure_estimate_waits_for_a_second_that_agrees() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    request = loop.tick(0, [])
    assert loop.answer(100 * MS, result(request, 10, estimate(quality=0.6))) == []
    assert loop.counters.unconfirmed == 1
    request = loop.tick(200 * MS, [])
    far = loop.answer(300 * MS, result(request, 210, estimate(T=pose(0.5), quality=0.6)))
    assert far == [], "somewhere else altogether"
    request = loop.tick(400 * MS, [])
    found = loop.answer(500 * MS, result(request, 410, estimate(T=pose(0.01), quality=0.6)))
    assert [c.verdict for c in found] == [Verdict.ACQUIRE]
    assert found[0].quality == pytest.approx(1 - 0.4 * 0.4)


def test_nonsense_is_never_used() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    for k in range(3):
        request = loop.tick(k * 200 * MS, [])
        bad = (estimate(quality=0.1), estimate(found=False, quality=0.0))
        assert loop.answer(k * 200 * MS + 50, result(request, k * 200, *bad)) == []
    assert loop.counters.rejected == 6


def test_agreement_and_disagreement() -> None:
    slot = ObjectSlot("mug", 1, diameter_m=0.15)
    for T, prior_score, state, verdict in (
        (pose(0.002), 2.0, State.TRACKING, Verdict.AGREE),
        (pose(0.03), 1.5, State.TRACKING, Verdict.CORRECT),
        (pose(0.03), 1.95, State.TRACKING, None),
        (pose(0.03), 1.95, State.SUSPECT, Verdict.CORRECT),
        (pose(0.03), None, State.TRACKING, None),
        (pose(0.03), None, State.SUSPECT, Verdict.CORRECT),
        (pose(0.0, 40.0), 1.5, State.TRACKING, Verdict.CORRECT),
    ):
        loop = ReinitLoop(objects=[slot])
        request = loop.tick(0, [track(state=state)])
        found = loop.answer(MS, result(request, 0, estimate(T=T, instance=0, prior_score=prior_score)))
        assert [c.verdict for c in found] == ([] if verdict is None else [verdict]), (T[0, 3], prior_score)


def test_equivalent_poses_agree() -> None:
    half_turn = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    turned = pose() @ half_turn
    for equivalents, verdict in (((), Verdict.CORRECT), ((np.eye(4), half_turn), Verdict.AGREE)):
        loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15, equivalents)])
        request = loop.tick(0, [track()])
        found = loop.answer(MS, result(request, 0, estimate(T=turned, instance=0, prior_score=1.0)))
        assert [c.verdict for c in found] == [verdict]


def test_the_track_is_compared_where_it_was_at_the_estimates_frame() -> None:
    """A fast object has moved 4 cm between the looked-at frame and the newest pose."""
    velocity = np.array([0.4, 0, 0, 0, 0, 0])
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1)])
    now = track(T=pose(0.04), velocity=velocity, stamp_ms=100)
    request = loop.tick(100 * MS, [now])
    found = loop.answer(200 * MS, result(request, 0, estimate(T=pose(0.0), instance=0, prior_score=2.0)))
    assert [c.verdict for c in found] == [Verdict.AGREE]


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


def test_a_second_sight_of_a_tracked_instance_is_no_new_one() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2, 0.15)])
    request = loop.tick(0, [track()])
    found = loop.answer(
        MS,
        result(request, 0, estimate(instance=0, prior_score=2.0), estimate(T=pose(0.03, 90.0), quality=0.99)),
    )
    assert [c.verdict for c in found] == [Verdict.AGREE]


def test_what_is_on_its_way_is_not_asked_for_again() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("cup", 1)])
    request = loop.tick(0, [])
    loop.answer(100 * MS, result(request, 10, estimate("mug")))
    assert asked(loop.tick(200 * MS, [])) == [("cup", None)]


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


def test_removed_objects_are_not_asked_for() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("cup", 1)])
    loop.remove("mug")
    request = loop.tick(0, [])
    assert asked(request) == [("cup", None)]
    assert loop.answer(MS, result(request, 0, estimate("mug"))) == []


def test_an_object_that_is_searched_anew_gets_a_new_number_and_no_old_answer() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert first is not None
    (sent,) = loop.answer(50 * MS, result(first, 20, estimate()))
    request = loop.tick(300 * MS, [track(stamp_ms=290, applied=sent.seq)])
    assert asked(request) == [("mug", 0)]
    # Numbers under 1 of this epoch are over: the caller shows the loop no such track any more.
    assert loop.forget("mug", 310 * MS) == (EPOCH, 1)
    assert loop.repeats(10_000 * MS) == []
    # The answer that is on its way was computed on a frame from before the order.
    assert request is not None
    assert loop.answer(350 * MS, result(request, 300, estimate())) == []
    again = loop.tick(600 * MS, [])
    assert asked(again) == [("mug", None)]
    assert again is not None
    (fresh,) = loop.answer(650 * MS, result(again, 610, estimate()))
    assert (fresh.instance, fresh.verdict) == (1, Verdict.ACQUIRE)


def test_what_is_on_its_way_is_over_as_well() -> None:
    loop = ReinitLoop(objects=[("mug", 1), ("jar", 1)])
    request = loop.tick(0, [])
    assert request is not None
    loop.answer(50 * MS, result(request, 20, estimate(), estimate("jar", pose(0.5))))
    assert loop.forget("mug", 60 * MS) == (EPOCH, 1)
    assert [c.object for c in loop.repeats(400 * MS)] == ["jar"]


def test_nothing_is_over_before_the_first_frame() -> None:
    assert ReinitLoop(objects=[("mug", 1)]).forget("mug") is None


def test_configuration_is_checked() -> None:
    with pytest.raises(InputError, match="deadline_ms"):
        ReinitConfig(deadline_ms=0)
    with pytest.raises(InputError, match="least_quality"):
        replace(ReinitConfig(), least_quality=0.95)
    with pytest.raises(InputError, match="max_instances"):
        ObjectSlot("mug", 0)


def uncertain(shift_m: float, turn_rad: float) -> np.ndarray:
    return np.diag([shift_m**2] * 3 + [turn_rad**2] * 3)


def test_what_both_uncertainties_allow_is_agreement() -> None:
    """15 mm apart, a tenth of the diameter: much for a sharp estimate, nothing special for a vague one."""
    off = estimate(T=pose(0.015), instance=0, prior_score=1.95)
    for covariance, verdicts in ((uncertain(0.001, 0.01), []), (uncertain(0.006, 0.05), [Verdict.AGREE])):
        loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15)])
        request = loop.tick(0, [track()])
        found = loop.answer(MS, result(request, 0, replace(off, covariance=covariance)))
        assert [c.verdict for c in found] == verdicts


def test_no_uncertainty_makes_a_flip_agree() -> None:
    flipped = estimate(T=pose(0.0, 180.0), instance=0, prior_score=1.95)
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15)])
    request = loop.tick(0, [track()])
    assert loop.answer(MS, result(request, 0, replace(flipped, covariance=uncertain(0.02, 3.0)))) == []
    assert loop.counters.rejected == 1


def test_where_the_tracked_pose_itself_goes_when_refined_is_a_correction() -> None:
    off = estimate(T=pose(0.03), instance=0, prior_score=2.0)
    for refined, verdicts in ((pose(0.031), [Verdict.CORRECT]), (pose(0.0), [])):
        loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15)])
        request = loop.tick(0, [track()])
        found = loop.answer(MS, result(request, 0, replace(off, prior_T_cam_obj=refined)))
        assert [c.verdict for c in found] == verdicts


def test_between_two_published_poses_the_track_is_interpolated() -> None:
    """It turned round between 0 and 200 ms, so neither pose nor velocity alone says where it was at 100."""
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15)])
    request = loop.tick(0, [track(T=pose(0.0), velocity=np.array([-0.4, 0, 0, 0, 0, 0]))])
    loop.tick(200 * MS, [track(T=pose(0.06), stamp_ms=200, velocity=np.array([-0.4, 0, 0, 0, 0, 0]))])
    found = loop.answer(210 * MS, result(request, 100, estimate(T=pose(0.03), instance=0, prior_score=2.0)))
    assert [c.verdict for c in found] == [Verdict.AGREE]


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
