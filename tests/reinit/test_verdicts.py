"""What an estimate means for an object that is tracked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.reinit import ObjectSlot, ReinitLoop
from huepose.tracking.types import Verdict

from .conftest import MS, estimate, pose, result, track, uncertain


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
        (pose(0.0, 40.0), 1.95, State.TRACKING, Verdict.REJECT),
        (pose(0.0, 40.0), None, State.TRACKING, None),
        (pose(0.03, 40.0), 1.95, State.TRACKING, Verdict.REJECT),
        (pose(0.05, 40.0), 1.95, State.TRACKING, None),
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


def test_an_uncertain_rotation_agrees_wherever_the_origin_is() -> None:
    """In 0.15 s it can have rotated by 23 degrees about its middle."""
    for middle in (np.zeros(3), np.array([2.0, 0.0, 0.0])):
        slot = ObjectSlot("mug", 1, 0.15, bounds_m=np.array([middle - 0.05, middle + 0.05]))
        about = se3.make(np.eye(3), -middle)
        to_origin = se3.carrying(-middle)
        covariance = to_origin @ uncertain(0.001, 0.01) @ to_origin.T
        seen = replace(track(T=pose() @ about), covariance=covariance)
        loop = ReinitLoop(objects=[slot])
        request = loop.tick(0, [seen])
        turned = estimate(T=pose(0.0, 23.0) @ about, instance=0, prior_score=1.0)
        turned = replace(turned, covariance=covariance)
        found = loop.answer(200 * MS, result(request, 150.0, turned))
        assert [c.verdict for c in found] == [Verdict.AGREE], middle


def test_an_uncertain_rotation_of_a_symmetric_object_agrees_wherever_the_origin_is() -> None:
    """The estimate is tilted by 22 degrees about the middle, and half a turn about the symmetry axis there:
    within four degrees of each, whether the origin is on that axis or not."""
    of_middle = uncertain(0.002, np.radians(4.0))
    for middle in (np.zeros(3), np.array([0.1, 0.0, 0.0])):
        half_turn = se3.make(np.diag([-1.0, -1.0, 1.0]), 2.0 * middle)
        bounds_m = np.array([middle - 0.05, middle + 0.05])
        slot = ObjectSlot("mug", 1, 0.14, (np.eye(4), half_turn), bounds_m)
        seen = se3.make(np.eye(3), np.array([0.0, 0.0, 0.7]) - middle)
        tilted = se3.moved(seen, middle, np.array([0.0, 0.0, 0.0, 0.0, np.radians(22.0), 0.0])) @ half_turn

        def about_its_origin(T: Float64, middle: Float64 = middle) -> Float64:
            to_origin = se3.carrying(-T[:3, :3] @ middle)
            return to_origin @ of_middle @ to_origin.T

        loop = ReinitLoop(objects=[slot])
        request = loop.tick(0, [replace(track(T=seen), covariance=about_its_origin(seen))])
        found = replace(estimate(T=tilted, instance=0), covariance=about_its_origin(tilted))
        assert [c.verdict for c in loop.answer(MS, result(request, 0, found))] == [Verdict.AGREE], middle


def test_a_second_estimate_of_a_tracked_instance_is_no_new_instance() -> None:
    loop = ReinitLoop(objects=[ObjectSlot("mug", 2, 0.15)])
    request = loop.tick(0, [track()])
    found = loop.answer(
        MS,
        result(request, 0, estimate(instance=0, prior_score=2.0), estimate(T=pose(0.03, 90.0), quality=0.99)),
    )
    assert [c.verdict for c in found] == [Verdict.AGREE]


def test_poses_within_both_uncertainties_agree() -> None:
    """15 mm apart, a tenth of the diameter: much for a certain estimate, usual for an uncertain one."""
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
    (denied,) = loop.answer(MS, result(request, 0, replace(flipped, covariance=uncertain(0.02, 3.0))))
    assert denied.verdict is Verdict.REJECT, "the tracker learns that its orientation is rejected"
    assert loop.counters.rejected == 1


def test_an_estimate_that_the_refined_track_agrees_with_is_a_correction() -> None:
    off = estimate(T=pose(0.03), instance=0, prior_score=2.0)
    for refined, verdicts in ((pose(0.031), [Verdict.CORRECT]), (pose(0.0), [])):
        loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15)])
        request = loop.tick(0, [track()])
        found = loop.answer(MS, result(request, 0, replace(off, prior_T_cam_obj=refined)))
        assert [c.verdict for c in found] == verdicts


def test_between_two_published_poses_the_track_is_interpolated() -> None:
    """It reversed between 0 and 200 ms, so neither pose nor velocity alone says where it was at 100 ms."""
    loop = ReinitLoop(objects=[ObjectSlot("mug", 1, 0.15)])
    request = loop.tick(0, [track(T=pose(0.0), velocity=np.array([-0.4, 0, 0, 0, 0, 0]))])
    loop.tick(200 * MS, [track(T=pose(0.06), stamp_ms=200, velocity=np.array([-0.4, 0, 0, 0, 0, 0]))])
    found = loop.answer(210 * MS, result(request, 100, estimate(T=pose(0.03), instance=0, prior_score=2.0)))
    assert [c.verdict for c in found] == [Verdict.AGREE]


@pytest.mark.parametrize("refined", [None, pose(0.12, 60.0)])
def test_a_comparison_with_the_pose_of_another_instance_does_not_count(refined: np.ndarray | None) -> None:
    """Instance 0 was taken away and instance 1 lies in its box. A wrongly rotated pose there explains more
    than none."""
    off = estimate(T=pose(0.12, 60.0), quality=0.4, score=1.0, prior_score=0.1)
    for instance, verdicts in ((0, []), (1, [(1, Verdict.CORRECT)])):
        loop = ReinitLoop(objects=[ObjectSlot("mug", 2, 0.15)])
        request = loop.tick(0, [track(), track(instance=1, T=pose(0.12))])
        found = loop.answer(MS, result(request, 0, replace(off, instance=instance, prior_T_cam_obj=refined)))
        assert [(c.instance, c.verdict) for c in found] == verdicts
