"""A relative pose whose rotation comes from a regressor: the paper's order, rotation first (section III-E).

The regressor sees canonical features alone. Given the rotation, every match votes for a translation, and the
translation that most of the weight agrees with is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.paper.canonical import canonical
from huepose.propose.relative_pose import LiftedMatches, Motion

ROUNDS = 8


class RotationRegressor(Protocol):
    """Anything that reads a turn out of canonical features."""

    def regress(self, features: Float32, weights: Float64) -> Float64:
        """Rotation (3, 3) from the first canonical frame to the second, of features (N, 15)."""
        ...


def translation_given(
    R_b_a: Float, points_a: Float, points_b: Float, weights: Float, inlier_m: float
) -> Float64:
    """Translation (3,) of a motion with a known rotation, from matched points (N, 3) with weights (N,): the
    component-wise median first, then a mean with Tukey's biweight, which forgets matches that are off by more
    than `inlier_m` metres. With no weight at all the plain median."""
    votes = np.asarray(points_b, np.float64) - np.asarray(points_a, np.float64) @ np.asarray(R_b_a).T
    t = np.median(votes, axis=0)
    for _ in range(ROUNDS):
        miss = np.linalg.norm(votes - t, axis=1)
        w = weights * np.maximum(1.0 - (miss / inlier_m) ** 2, 0.0) ** 2
        if w.sum() <= 0.0:
            break
        t = w @ votes / w.sum()
    return np.asarray(t)


def motion_given(R_b_a: Float, matches: LiftedMatches, inlier_m: float, min_inliers: int) -> Motion | None:
    """The motion with a known rotation (3, 3); None when fewer than `min_inliers` matches lie within
    `inlier_m` metres of it."""
    t = translation_given(R_b_a, matches.points_a, matches.points_b, matches.weights, inlier_m)
    T = se3.orthonormalised(se3.make(R_b_a, t))
    miss = np.linalg.norm(se3.apply(T, matches.points_a) - matches.points_b, axis=1)
    inliers = int((miss < inlier_m).sum())
    return Motion(T, inliers, len(matches)) if inliers >= min_inliers else None


@dataclass(frozen=True)
class RotationFirst:
    """A RelativePose by a regressor. inlier_m: residual of a believed match, metres; min_inliers under which
    there is no motion."""

    regressor: RotationRegressor
    inlier_m: float = 0.006
    min_inliers: int = 8

    def estimate(self, matches: LiftedMatches) -> Motion | None:
        """See RelativePose."""
        if len(matches) < self.min_inliers:
            return None
        seen = canonical(matches.points_a, matches.points_b, matches.weights)
        R = seen.rotation(self.regressor.regress(seen.features, matches.weights))
        return motion_given(R, matches, self.inlier_m, self.min_inliers)
