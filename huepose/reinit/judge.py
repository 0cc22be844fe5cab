"""Assign estimates to tracked instances (optimal assignment on pose distance, gated by covariance), and
compare each with its track: agree, correct, acquire or reject."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.believe.state import State
from huepose.estimation.types import PoseEstimate
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.se3 import carrying, mahalanobis
from huepose.reinit.config import ReinitConfig
from huepose.reinit.types import ObjectSlot, Prior
from huepose.tracking.types import Verdict

SAME_POSE = 0.08
"""Poses whose surfaces are closer than this share of the diameter are the same."""

SIGMAS_APART, NEVER_SAME = 4.1, 0.25
"""Poses are also the same within this Mahalanobis distance of both covariances (99 % at six degrees of
freedom), but never beyond this share of the diameter."""

TURN_LEVER = 0.25
"""Mean distance of a surface from an axis through its middle, as a share of the diameter."""

SAME_REFINED = 0.04
"""An estimate closer to the refined prior than this share of the diameter is the same pose."""

SAME_SIGHT, SAME_SIGHT_SPEED_M_S, SAME_SIGHT_S = 0.5, 0.4, 1.0
"""Two sightings of an untracked object agree within this share of its diameter plus the distance that a hand
moves it in between. The time in between counts up to the last number, in seconds."""


def judge_tracked(
    estimate: PoseEstimate,
    tracked: Prior,
    stamp_ns: int,
    state: State,
    slot: ObjectSlot,
    config: ReinitConfig,
) -> Verdict:
    """Verdict on an estimate of an object that has a pose. tracked: that pose at or near the estimate's
    timestamp.

    AGREE: both are the same pose within tolerance or within their uncertainties. Otherwise the estimate wins
    if it explains the image better than the refined prior (scores on the same pixels), or if the tracked
    pose, when refined, converges to it. Without such a comparison it wins only over a doubtful pose, and only
    from `acquire_quality` on.
    """
    if not usable(estimate, config) or estimate.T_cam_obj is None:
        return Verdict.REJECT
    if agrees(estimate, tracked, stamp_ns, slot):
        return Verdict.AGREE
    doubtful = state is State.SUSPECT
    if estimate.prior_score is None:
        convincing = doubtful and estimate.quality >= config.acquire_quality
        return Verdict.CORRECT if convincing else Verdict.REJECT
    margin = config.doubtful_margin if doubtful else config.correct_margin
    if estimate.score > estimate.prior_score + margin:
        return Verdict.CORRECT
    refined = estimate.prior_T_cam_obj
    same = refined is not None and _apart(estimate.T_cam_obj, refined, slot) < SAME_REFINED
    return Verdict.CORRECT if same else Verdict.REJECT


def agrees(estimate: PoseEstimate, tracked: Prior, stamp_ns: int, slot: ObjectSlot) -> bool:
    """Whether an estimate and a tracked pose may be the same pose."""
    T, expected = estimate.T_cam_obj, tracked.predicted(stamp_ns, slot.middle_obj)
    assert T is not None
    apart = _apart(T, expected, slot)
    if apart < SAME_POSE:
        return True
    covariance = tracked.covariance_at(stamp_ns, slot.middle_obj)
    if apart > NEVER_SAME or estimate.covariance is None or covariance is None:
        return False
    for turn in slot.equivalents or (np.eye(4),):
        alike = T @ turn
        # The estimate's covariance is about its own origin, which may be far from that of the turned pose.
        to_origin = carrying(alike[:3, 3] - T[:3, 3])
        both = to_origin @ estimate.covariance @ to_origin.T + covariance
        if mahalanobis(expected, alike, both) < SIGMAS_APART:
            return True
    return False


def _apart(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> float:
    """Surface distance of two poses, as a share of the diameter."""
    return displacement_m(T_a, T_b, slot) / slot.diameter_m


def denies_orientation(estimate: PoseEstimate, tracked: Prior, stamp_ns: int, slot: ObjectSlot) -> bool:
    """Whether an estimate has the object at the position of the tracked pose, in another orientation. Both
    must have been scored on the same pixels."""
    T, expected = estimate.T_cam_obj, tracked.predicted(stamp_ns, slot.middle_obj)
    if T is None or estimate.prior_score is None:
        return False
    there = _shift_m(T, expected, slot) < NEVER_SAME * slot.diameter_m
    return there and TURN_LEVER * _turn_rad(T, expected, slot) > SAME_POSE


def acquires(estimate: PoseEstimate, config: ReinitConfig) -> bool:
    """Whether one usable estimate is enough to acquire an object that has no pose."""
    return estimate.chance >= config.acquire_quality


def pose_of(estimate: PoseEstimate) -> Float64:
    """The pose (4, 4) of an estimate with `found`. Raises ValueError if there is none."""
    if estimate.T_cam_obj is None:
        raise ValueError(f"an estimate of {estimate.object} that was found has no pose")
    return estimate.T_cam_obj


def usable(estimate: PoseEstimate, config: ReinitConfig) -> bool:
    """Whether an estimate may be used at all."""
    return estimate.found and estimate.T_cam_obj is not None and estimate.quality >= config.least_quality


def same_sighting(T_a: Float64, T_b: Float64, seconds: float, slot: ObjectSlot) -> bool:
    """Whether two estimates, `seconds` apart, can be of the same untracked object."""
    reach = SAME_SIGHT * slot.diameter_m + SAME_SIGHT_SPEED_M_S * min(abs(seconds), SAME_SIGHT_S)
    return displacement_m(T_a, T_b, slot) < reach


GATE_SIGMAS = 3.0
"""An estimate within this many standard deviations of the expected position of an instance may be that
instance."""

GATE_DIAMETERS = 0.5
"""Gate in diameters, whatever the covariance: an estimate closer than this can be the instance, one at four
times this distance cannot."""

TURN_SHARE = 0.1
"""Weight of rotation in the pose distance, for instances at equal distance: a rotation by half a circle
counts as a third of a diameter."""


def near(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> bool:
    """Whether two poses of one object must be of one instance, since two would overlap: the middle of one is
    closer to the other's bounds than a quarter of its least side. If the bounds are not known: their origins
    are closer than half a diameter."""
    if slot.bounds_m is None:
        return _shift_m(T_a, T_b, slot) < 0.5 * slot.diameter_m
    middle, half = slot.middle_obj, 0.5 * np.ptp(slot.bounds_m, axis=0)
    there = se3.inverse(T_b) @ T_a, se3.inverse(T_a) @ T_b
    off = np.abs([se3.apply(T, middle[None])[0] - middle for T in there])
    return bool((off < half + 0.5 * half.min()).all(1).any())


def displacement_m(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> float:
    """Approximate surface distance of two poses T_cam_obj (4, 4), metres, the least over the object's
    symmetries."""
    turns = slot.equivalents or (np.eye(4),)
    return min(_displacement(T_a, T_b @ turn, slot) for turn in turns)


def _displacement(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> float:
    return _shift_m(T_a, T_b, slot) + TURN_LEVER * slot.diameter_m * se3.rotation_angle(T_a, T_b)


def _turn_rad(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> float:
    """Angle between two poses T_cam_obj (4, 4), the least over the object's symmetries."""
    return min(se3.rotation_angle(T_a @ turn, T_b) for turn in slot.equivalents or (np.eye(4),))


def _shift_m(T_a: Float64, T_b: Float64, slot: ObjectSlot) -> float:
    """Distance of the object's middle in two poses (4, 4), metres."""
    return float(np.linalg.norm(slot.middle_cam(T_a) - slot.middle_cam(T_b)))


def assign(
    estimates: Sequence[Float64],
    priors: Sequence[Prior],
    stamp_ns: int,
    slot: ObjectSlot,
    sure: Sequence[bool] = (),
) -> list[int | None]:
    """For each estimated pose the index of its instance, or None.

    Every instance is predicted to `stamp_ns`. Of all assignments within the gates, those with the most pairs
    are taken, and of these the one with the least sum of distances. sure: which instances are at their
    expected poses, so that a pose beside one is of another instance.
    """
    # Every worker imports this package for its types. This import takes a quarter of a second more, or
    # seconds on a busy computer that reads it from disk: see `warm_up`.
    from scipy.optimize import linear_sum_assignment

    out: list[int | None] = [None] * len(estimates)
    if not estimates or not priors:
        return out
    sure = sure or [False] * len(priors)
    cost = np.empty((len(estimates), len(priors)))
    for j, prior in enumerate(priors):
        expected = prior.predicted(stamp_ns, slot.middle_obj)
        gate = _gate_m(prior, stamp_ns, slot)
        for i, T in enumerate(estimates):
            shift = _shift_m(T, expected, slot)
            turn = _turn_rad(T, expected, slot)
            outside = shift > gate or (sure[j] and not near(T, expected, slot))
            cost[i, j] = 1e3 if outside else shift + TURN_SHARE * slot.diameter_m * turn
    for i, j in zip(*linear_sum_assignment(cost), strict=True):
        if cost[i, j] < 1e3:
            out[i] = int(j)
    return out


def _gate_m(prior: Prior, stamp_ns: int, slot: ObjectSlot) -> float:
    least, most = GATE_DIAMETERS * slot.diameter_m, 2.0 * slot.diameter_m
    covariance = prior.covariance_at(stamp_ns, slot.middle_obj)
    if covariance is None:
        return most
    to_middle = carrying(prior.lever(slot.middle_obj))
    of_middle = to_middle @ covariance @ to_middle.T
    sigma = float(np.sqrt(max(np.linalg.eigvalsh(of_middle[:3, :3])[-1], 0.0)))
    return min(max(least, GATE_SIGMAS * sigma), most)
