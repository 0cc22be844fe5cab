"""From evidence to quality to states, and what identity and competition add; no pictures needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Camera, se3
from huepose.tracking import State, TrackerConfig
from huepose.tracking.competition import Claim, losers
from huepose.tracking.evidence import (
    Standing,
    bounded,
    next_standing,
    quality,
    scarce,
    tint_after,
    usual_after,
)
from huepose.tracking.identity import Identity
from huepose.tracking.scoring import NOTHING, UNKNOWN_TINT, Fit
from huepose.tracking.silhouette import overlap, visible_mask
from huepose.tracking.surface import TrackedSurface
from huepose.tracking.uncertainty import covariance, unseen

GOOD = Fit(1.5, 0.85, 0.0, 0.7, 0.0, 0.9, 0.001, 0.0, 0.05, 40.0, (0.9, 1.0, 1.0))
CONFIG = TrackerConfig()


def run(qualities: list[float], confirmed: bool = True, start: State = State.TRACKING) -> list[State]:
    standing, out = Standing(start), []
    for q in qualities:
        standing = next_standing(standing, q, confirmed, CONFIG)
        out.append(standing.state)
    return out


def test_good_and_bad_evidence() -> None:
    assert quality(GOOD, None, 0.0) > 0.9
    assert quality(NOTHING, None, 1.0) < 0.05
    assert quality(replace(GOOD, color=0.0, depth_fit=0.5), None, 0.0) < 0.1
    assert quality(GOOD, None, 1.0) > quality(GOOD, None, 0.0), "right a frame ago"


def test_each_piece_of_evidence_counts() -> None:
    base = replace(GOOD, color=0.3)
    q = quality(base, None, 0.0)
    assert quality(replace(base, depth_fit=0.6), None, 0.0) < q
    assert quality(replace(base, behind=0.2), None, 0.0) < q
    assert quality(replace(base, color=0.1), None, 0.0) < q


def test_a_sudden_drop_under_the_usual_counts() -> None:
    fit = replace(GOOD, total=0.8, color=0.35)
    assert quality(fit, 1.6, 1.0) < quality(fit, 0.9, 1.0)


def test_one_sense_alone_is_doubtful_at_best() -> None:
    blind = replace(GOOD, seen=0.0, depth_fit=0.0, no_depth=0.95)
    dazzled = replace(GOOD, color=0.0, texture=0.0, tint=UNKNOWN_TINT)
    for fit in (blind, dazzled):
        assert CONFIG.lost_quality < quality(fit, 1.5, 1.0) < CONFIG.suspect_quality
    assert quality(replace(dazzled, depth_fit=0.2, behind=0.6), None, 1.0) < CONFIG.lost_quality


def test_a_strip_beside_a_hand_is_followed_for_a_moment_only() -> None:
    strip = replace(GOOD, seen=0.1, hidden=0.8)
    assert scarce(strip)
    assert not scarce(replace(strip, seen=0.3))
    assert not scarce(replace(strip, hidden=0.0, no_depth=0.9)), "a blind sensor hides nothing"
    trust = [bounded(0.9, k) for k in range(12)]
    assert trust[0] == 0.9
    assert CONFIG.lost_quality < trust[5] < CONFIG.suspect_quality
    assert trust[11] < CONFIG.lost_quality


def test_suspect_at_once_lost_soon() -> None:
    suspect = [State.SUSPECT] * (CONFIG.lost_after - 1)
    assert run([0.9] + [0.1] * 6) == [State.TRACKING, *suspect, State.LOST, State.LOST]
    assert CONFIG.lost_after <= 5


def test_suspect_returns_after_two_supported_frames() -> None:
    assert run([0.4, 0.9, 0.9]) == [State.SUSPECT, State.SUSPECT, State.TRACKING]


def test_a_single_good_frame_breaks_the_way_to_lost() -> None:
    assert State.LOST not in run([0.1, 0.1, 0.1, 0.7, 0.1, 0.1, 0.1])


def test_doubtful_but_not_unsupported_is_never_lost() -> None:
    assert set(run([0.4] * 50)) == {State.SUSPECT}


def test_unconfirmed_is_never_tracking() -> None:
    assert set(run([0.95] * 10, confirmed=False)) == {State.SUSPECT}


@pytest.mark.parametrize("start", [State.LOST, State.SEARCHING])
def test_up_from_nothing_only_by_correction(start: State) -> None:
    assert set(run([0.99] * 10, start=start)) == {start}


def test_what_is_usual_follows_slowly() -> None:
    assert usual_after(None, 1.4) == 1.4
    assert 1.4 < usual_after(1.4, 1.6) < 1.45
    assert tint_after(UNKNOWN_TINT, GOOD.tint) == GOOD.tint
    assert tint_after(GOOD.tint, UNKNOWN_TINT) == GOOD.tint
    assert 0.9 < tint_after(GOOD.tint, (1.4, 1.0, 1.0))[0] < 1.1


def test_identity_grows_with_agreement_and_new_viewpoints() -> None:
    front, side = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    doubtful = Identity.of(0.6, front)
    assert doubtful.agreed(0.5, front).value == pytest.approx(0.8)
    assert doubtful.agreed(0.8, front).value == pytest.approx(0.8), "the same mistake would be made again"
    assert doubtful.agreed(0.95, front).value == pytest.approx(0.95)
    assert doubtful.agreed(0.8, side).value == pytest.approx(0.92)
    assert doubtful.carried(GOOD, front) is doubtful, "the same side says nothing new"
    assert doubtful.carried(replace(GOOD, color=0.2), side) is doubtful, "nor does a side without a print"
    carried = doubtful.carried(GOOD, side)
    assert carried.value == pytest.approx(0.8)
    assert carried.carried(GOOD, side) is carried
    assert carried.carried(GOOD, front).value == pytest.approx(0.9)
    assert Identity.of(1.0, front).value < 1.0


def test_the_weaker_of_two_poses_on_one_surface_loses(tea_box, shoot, path) -> None:
    surface = TrackedSurface.of(tea_box)
    beside = se3.make(path(0)[:3, :3], path(0)[:3, 3] + [0.15, 0.0, 0.0])
    frame = shoot([(tea_box.mesh, path(0)), (tea_box.mesh, beside)])
    good, same = Claim(surface, path(0), 1.6), Claim(surface, se3.perturb(path(0), np.full(6, 0.003)), 1.2)
    other = Claim(surface, beside, 0.9)
    assert losers([good, same, other], frame.depth, frame.camera) == [1]
    assert losers([same, good, other], frame.depth, frame.camera) == [0]
    assert losers([good, other], frame.depth, frame.camera) == []
    assert losers([good], frame.depth, frame.camera) == []
    assert losers([], frame.depth, frame.camera) == []


def test_masks_are_what_is_seen_of_the_object(tea_box, soup_can, shoot, path) -> None:
    surface = TrackedSurface.of(tea_box)
    box = surface.box(path(0), shoot([]).camera)
    assert box is not None
    alone = visible_mask(tea_box.mesh, path(0), shoot([(tea_box.mesh, path(0))]), box)
    near = se3.make(np.eye(3), path(0)[:3, 3] * 0.7)
    covered = visible_mask(
        tea_box.mesh, path(0), shoot([(tea_box.mesh, path(0)), (soup_can.mesh, near)]), box
    )
    assert alone.sum() > 3000
    assert covered.sum() < 0.8 * alone.sum()
    assert not (covered & ~alone).any()
    assert visible_mask(tea_box.mesh, path(0), shoot([]), box).sum() == 0


def test_overlap_of_outlines(tea_box, path) -> None:
    camera = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
    surface, T = TrackedSurface.of(tea_box), path(0)

    def iou(other: np.ndarray) -> float:
        return overlap(tea_box.mesh, T, other, surface.box(T, camera), surface.box(other, camera), camera)

    assert iou(T) == 1.0
    assert iou(T @ se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))) > 0.97, "half a turn of a box"
    assert 0.6 < iou(se3.perturb(T, np.array([0.01, 0, 0, 0, 0, 0]))) < 0.95
    assert iou(se3.perturb(T, np.array([0.3, 0, 0, 0, 0, 0]))) == 0.0
    assert overlap(tea_box.mesh, T, T, None, None, camera) == 0.0


def test_covariance_follows_information_and_grows_unseen() -> None:
    strong = covariance(np.diag([1e9] * 3 + [1e6] * 3), 0.6)
    weak = covariance(np.diag([1e9] * 3 + [1e6, 1e6, 10.0]), 0.6)
    assert np.sqrt(strong[0, 0]) < 0.001
    assert np.sqrt(strong[5, 5]) < 0.01
    assert np.sqrt(weak[5, 5]) > 0.2, "a turn that nothing fixes"
    assert covariance(np.zeros((6, 6)), 0.6)[0, 0] == pytest.approx(0.05**2, rel=1e-2)
    assert strong[2, 2] < covariance(np.diag([1e9] * 3 + [1e6] * 3), 1.5)[2, 2], "far away is less exact"
    later = unseen(strong, 0.2)
    assert (np.diag(later) > np.diag(strong)).all()
    assert np.linalg.eigvalsh(later).min() > 0
