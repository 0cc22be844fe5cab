"""The motion between two frames from 3D correspondences (paper, section III-E, third step).

The paper regresses the rotation with a network. The closed form here, a robust weighted Kabsch fit, needs no
training; both implement the protocol `RelativePose`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from huepose.geometry import kabsch
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.lifting import lift
from huepose.paper.correspondences import Correspondences


@dataclass(frozen=True, eq=False)
class LiftedMatches:
    """points_a, points_b (N, 3): the same surface points in camera axes at two moments; pixels_a, pixels_b
    (N, 2); weights (N,)."""

    points_a: Float64
    points_b: Float64
    pixels_a: Float64
    pixels_b: Float64
    weights: Float64

    def __len__(self) -> int:
        return len(self.points_a)


@dataclass(frozen=True, eq=False)
class Motion:
    """T_b_a (4, 4): moves points of the first moment to the second, both in camera axes; inliers of
    `matches`."""

    T_b_a: Float64
    inliers: int
    matches: int


class RelativePose(Protocol):
    """Estimates a rigid motion from 3D correspondences."""

    def estimate(self, matches: LiftedMatches) -> Motion | None:
        """The motion, or None when the matches do not determine one."""
        ...


class RobustKabsch:
    """RANSAC over triples, then reweighted least squares (`kabsch.motion`)."""

    def estimate(self, matches: LiftedMatches) -> Motion | None:
        """See RelativePose; the same matches give the same motion."""
        found = kabsch.motion(matches.points_a, matches.points_b, matches.weights)
        return None if found is None else Motion(*found, len(matches))


def lift_matches(frame_a: RgbdFrame, frame_b: RgbdFrame, matches: Correspondences) -> LiftedMatches:
    """Both ends of the matches in 3D; those without depth at either end are dropped."""
    a, known_a = lift(frame_a.depth, frame_a.camera, matches.pixels_a)
    b, known_b = lift(frame_b.depth, frame_b.camera, matches.pixels_b)
    k = known_a & known_b
    return LiftedMatches(a[k], b[k], matches.pixels_a[k], matches.pixels_b[k], matches.weights[k])
