"""How still a pose is that stands still, whether its covariance is true, and how well motion is foretold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.tracking.motion import predicted
from studies.hard_moments.play import Told

AHEAD_FRAMES = (1, 2, 3)
"""33, 66 and 100 ms at 30 Hz."""


@dataclass(frozen=True)
class Stillness:
    """Of an object at rest. tremble: RMS of the translation (mm) and of the turn (degrees) about their
    means; error: RMS against the truth; covered: percent of the errors' components within two sigmas."""

    tremble_mm: float
    tremble_deg: float
    error_mm: float
    error_deg: float
    covered: float


def stillness(told: Sequence[Told]) -> Stillness:
    """Figures of frames that all have a pose and the same truth. Raises ValueError without a pose."""
    errors = errors_of(told)
    if len(errors) != len(told):
        raise ValueError(f"{len(told) - len(errors)} of {len(told)} frames have no pose")
    about = errors - errors.mean(0)
    return Stillness(
        1e3 * _rms(about[:, :3]),
        float(np.degrees(_rms(about[:, 3:]))),
        1e3 * _rms(errors[:, :3]),
        float(np.degrees(_rms(errors[:, 3:]))),
        covered(told),
    )


def errors_of(told: Sequence[Told]) -> Float64:
    """Differences (K, 6) from the truth to the poses that there are: metres and radians, camera axes."""
    found = [
        se3.difference(t.truth, t.pose.T_cam_obj)
        for t in told
        if t.pose is not None and t.pose.T_cam_obj is not None
    ]
    return np.array(found).reshape(-1, 6)


def covered(told: Sequence[Told]) -> float:
    """Percent of the components of all errors within two published sigmas; true covariances give 95."""
    inside = [
        np.abs(se3.difference(t.truth, t.pose.T_cam_obj)) < 2.0 * np.sqrt(np.diag(t.pose.covariance))
        for t in told
        if t.pose is not None and t.pose.T_cam_obj is not None and t.pose.covariance is not None
    ]
    return 100.0 * float(np.mean(inside)) if inside else 0.0


def lag_s(told: Sequence[Told]) -> float:
    """By how many seconds the poses trail behind a truth that moves: the mean of the distance along its way
    over its speed, where it is faster than a centimetre a second."""
    lags = []
    for before, now in pairwise(told):
        seconds = (now.stamp_ns - before.stamp_ns) * 1e-9
        velocity = (now.truth[:3, 3] - before.truth[:3, 3]) / seconds
        speed = float(np.linalg.norm(velocity))
        if speed > 0.01 and now.pose is not None and now.pose.T_cam_obj is not None:
            behind = now.truth[:3, 3] - now.pose.T_cam_obj[:3, 3]
            lags.append(float(behind @ velocity) / speed**2)
    return float(np.mean(lags)) if lags else 0.0


def foretold(told: Sequence[Told], ahead: int) -> tuple[Float64, Float64]:
    """Errors (K,) in mm and (K,) in degrees of poses carried `ahead` frames on by their own velocity, where
    the pose was right to begin with."""
    mm, degrees = [], []
    for now, then in zip(told[:-ahead], told[ahead:], strict=True):
        if now.pose is None or now.pose.T_cam_obj is None or not now.right:
            continue
        T = predicted(now.pose.T_cam_obj, now.pose.velocity, (then.stamp_ns - now.stamp_ns) * 1e-9)
        mm.append(1e3 * float(np.linalg.norm(T[:3, 3] - then.truth[:3, 3])))
        degrees.append(float(np.degrees(se3.rotation_angle(T, then.truth))))
    return np.array(mm), np.array(degrees)


def _rms(vectors: Float64) -> float:
    """Of the vectors' lengths."""
    return float(np.sqrt((vectors**2).sum(1).mean()))
