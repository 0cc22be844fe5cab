"""What an estimate means for an object: agree, correct, acquire, reject."""

from __future__ import annotations

from huepose.estimation.types import PoseEstimate
from huepose.geometry.arrays import Float64
from huepose.reinit.association import displacement_m
from huepose.reinit.config import ReinitConfig
from huepose.reinit.types import ObjectSlot
from huepose.tracking.types import State, Verdict

SAME_POSE = 0.08
"""Poses whose surfaces lie closer than this share of the diameter are one pose."""

SAME_SIGHT = 0.5
SAME_SIGHT_SPEED_M_S = 0.4
"""Two sightings of an object that is not tracked agree within this share of its diameter, and what a hand
does in between."""


def judge_tracked(
    estimate: PoseEstimate, T_tracked: Float64, state: State, slot: ObjectSlot, config: ReinitConfig
) -> Verdict:
    """Verdict on an estimate of an object that has a pose; T_tracked: that pose at the estimate's frame.

    An estimate that disagrees wins only if it explains the image better: its score against that of the
    refined prior, both on the same pixels. Without such a comparison it wins only over a doubtful pose, and
    only with the quality that acquires.
    """
    if not estimate.found or estimate.T_cam_obj is None or estimate.quality < config.least_quality:
        return Verdict.REJECT
    if displacement_m(estimate.T_cam_obj, T_tracked, slot) < SAME_POSE * slot.diameter_m:
        return Verdict.AGREE
    doubtful = state is State.SUSPECT
    if estimate.prior_score is None:
        convincing = doubtful and estimate.quality >= config.acquire_quality
        return Verdict.CORRECT if convincing else Verdict.REJECT
    margin = config.doubtful_margin if doubtful else config.correct_margin
    return Verdict.CORRECT if estimate.score > estimate.prior_score + margin else Verdict.REJECT


def acquires(estimate: PoseEstimate, config: ReinitConfig) -> bool:
    """Whether one estimate is enough to acquire an object that has no pose."""
    return estimate.found and estimate.quality >= config.acquire_quality


def usable(estimate: PoseEstimate, config: ReinitConfig) -> bool:
    """Whether an estimate may be used at all."""
    return estimate.found and estimate.T_cam_obj is not None and estimate.quality >= config.least_quality


def same_sight(T_a: Float64, T_b: Float64, seconds: float, slot: ObjectSlot) -> bool:
    """Whether two estimates that lie that far apart in time can be of one object that is not tracked."""
    reach = SAME_SIGHT * slot.diameter_m + SAME_SIGHT_SPEED_M_S * abs(seconds)
    return displacement_m(T_a, T_b, slot) < reach
