"""The motion between two frames from 3D correspondences (paper, section III-E, third step).

The paper regresses the rotation with a network. The closed form here, a robust weighted Kabsch fit, needs no
training; both are a `RelativePose`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from huepose.geometry import kabsch
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.lifting import lift
from huepose.paper.correspondences import Correspondences


@dataclass(frozen=True, eq=False)
class LiftedMatches:
    """points_a, points_b (N, 3): the same surface points in two frames, camera axes; weights (N,)."""

    points_a: Float64
    points_b: Float64
    weights: Float64

    def __len__(self) -> int:
        return len(self.points_a)


RelativePose = Callable[[LiftedMatches], Float64 | None]
"""The motion T_b_a (4, 4), which moves points of the first frame to the second, both in camera axes; None
when the matches do not determine one."""


def robust_kabsch(matches: LiftedMatches) -> Float64 | None:
    """A RelativePose: RANSAC over triples, then reweighted least squares; the same matches give the same
    motion."""
    return kabsch.motion(matches.points_a, matches.points_b, matches.weights)


def lift_matches(frame_a: RgbdFrame, frame_b: RgbdFrame, matches: Correspondences) -> LiftedMatches:
    """The matches in 3D; a match without depth at one of its ends is dropped."""
    a, known_a = lift(frame_a.depth, frame_a.camera, matches.pixels_a)
    b, known_b = lift(frame_b.depth, frame_b.camera, matches.pixels_b)
    k = known_a & known_b
    return LiftedMatches(a[k], b[k], matches.weights[k])
