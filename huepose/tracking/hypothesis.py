"""A hypothesis of a pose, and an object in the last frame. A track holds up to three hypotheses; the next
frames decide between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.terms import Terms
from huepose.select.distinct import RIGHT
from huepose.support.jit import jit
from huepose.tracking.motion import Reach
from huepose.tracking.subject import Subject
from huepose.tracking.usual import Usual

MOST = 3
"""Most hypotheses of a track."""

SAME = 0.05
"""Poses whose surfaces are within this share of the diameter are one pose."""

FOLLOWED, LOOKED_FOR = ("still", "velocity"), ("search", "views")
FOUND_AGAIN = (*LOOKED_FOR, "turn")
"""Sources of hypotheses: FOLLOWED from the last frame, or found by a search (LOOKED_FOR); FOUND_AGAIN adds
those that were followed and then rotated."""

HOPELESS = 4.0
"""A hypothesis whose log-odds are this far behind the best is dropped."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """T_cam_obj (4, 4); velocity (6,) or None, about the object's centre; terms of the judge; information (6,
    6) of the refinement; source: the start that led there ("still", "velocity", "search", "views", "turn",
    "correction"); log_odds: that it is right, filtered over the frames; goes_on: share of its outline beyond
    which the surface goes on; jump: log-odds of the motion to it, 0 or less if it was found, 0 if it was
    followed."""

    T_cam_obj: Float64
    terms: Terms
    information: Float64
    source: str
    velocity: Float64 | None = None
    log_odds: float = 0.0
    goes_on: float = 0.0
    jump: float = 0.0

    def seen_from(self, T_new_old: Float64) -> Hypothesis:
        """The same pose and motion in the axes of a camera that has moved; T_new_old (4, 4): from the old
        axes to the new ones."""
        velocity = None if self.velocity is None else se3.along(T_new_old[:3, :3]) @ self.velocity
        return replace(self, T_cam_obj=se3.compose(T_new_old, self.T_cam_obj), velocity=velocity)


@dataclass(frozen=True, eq=False)
class Anchor:
    """The object in the last frame. hypotheses: best first; usual: usual total and light; unseen_s: for how
    long its pose has only been predicted; place: the most probable place in the last frame, if no search was
    made there yet; known: its identity is confirmed; turn_odds: log-odds of its orientation."""

    hypotheses: tuple[Hypothesis, ...]
    frame: RgbdFrame
    usual: Usual = field(default_factory=Usual)
    unseen_s: float = 0.0
    place: Reach | None = None
    known: bool = False
    turn_odds: float = 0.0

    @property
    def first(self) -> Hypothesis:
        """The best hypothesis."""
        return self.hypotheses[0]


def same_pose(subject: Subject, T_a: Float64, T_b: Float64, share: float = SAME) -> bool:
    """Whether two poses (4, 4) are closer than a share of the diameter, up to the rotations under which the
    object looks the same."""
    # Copies: for each kind of array the kernel would be compiled once more.
    here, there = np.array(T_a, np.float64, order="C"), np.array(T_b, np.float64, order="C")
    return bool(_apart_m(subject.points, here, there) < share * subject.surface.diameter_m)


@jit
def _apart_m(points: Float64, T_a: Float64, T_b: Float64) -> float:
    """Mean distance of points (N, 3) = points[0] at two poses (4, 4); the smallest for those rotations under
    which the object looks the same that give points (K, N, 3)."""
    least = np.inf
    for k in range(points.shape[0]):
        total = 0.0
        for i in range(points.shape[1]):
            square = 0.0
            for r in range(3):
                off = T_b[r, 3] - T_a[r, 3]
                for c in range(3):
                    off += T_b[r, c] * points[k, i, c] - T_a[r, c] * points[0, i, c]
                square += off * off
            total += np.sqrt(square)
        least = min(least, total / points.shape[1])
    return least


def distinct(subject: Subject, opinions: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """The most probable different hypotheses, at most three, best first, without hopeless ones."""
    kept: list[Hypothesis] = []
    for one in sorted(opinions, key=lambda h: -h.log_odds):
        if kept and one.log_odds < kept[0].log_odds - HOPELESS:
            break
        if len(kept) < MOST and not any(same_pose(subject, one.T_cam_obj, k.T_cam_obj) for k in kept):
            kept.append(one)
    return tuple(kept)


def share_of_first(subject: Subject, opinions: Sequence[Hypothesis]) -> float:
    """The share of the belief in the first of different hypotheses: its own, and that of those so close that
    both would be right (`RIGHT`). 0 without any."""
    return sum(
        share
        for k, (one, share) in enumerate(zip(opinions, shares(opinions), strict=True))
        if k == 0 or same_pose(subject, opinions[0].T_cam_obj, one.T_cam_obj, RIGHT)
    )


def shares(opinions: Sequence[Hypothesis]) -> list[float]:
    """The share of the belief in each of different hypotheses; together 1."""
    logs = np.array([h.log_odds for h in opinions])
    return [float(1.0 / np.exp(logs - log).sum()) for log in logs]
