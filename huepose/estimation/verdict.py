"""The last word on proposals: which of the poses of a frame stand when all are judged together?

A detector proposes places for objects that may not be there, several of an object, and the same place to
several objects. A pose stands when it is sure enough, and when it explains depth that no better pose
explains: one surface, one pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.estimation.types import PoseEstimate
from huepose.geometry.arrays import Bool

ACCEPTED = 0.85
"""Quality under which a pose at a place that was only proposed is not believed."""

CLAIMED = 0.5
"""A pose whose visible pixels were explained by better poses to this share has nothing of its own."""


def standing(
    answers: Sequence[PoseEstimate], accepted: float = ACCEPTED, log_odds: Sequence[float] = ()
) -> list[PoseEstimate]:
    """The answers that stand, surest first. log_odds: what a detector's evidence adds to the quality of each
    answer, if anything. Answers that were not found are left out; one without a mask claims nothing and is
    not contested."""
    added = log_odds or [0.0] * len(answers)
    believed = [(_believed(a.quality, x), a) for a, x in zip(answers, added, strict=True) if a.found]
    taken: Bool | None = None
    out: list[PoseEstimate] = []
    for quality, answer in sorted(believed, key=lambda item: -item[0]):
        if quality < accepted:
            continue
        if answer.mask is not None:
            taken = np.zeros_like(answer.mask) if taken is None else taken
            size = int(answer.mask.sum())
            if not size or int((answer.mask & taken).sum()) > CLAIMED * size:
                continue
            taken |= answer.mask
        out.append(answer)
    return out


def _believed(quality: float, log_odds: float) -> float:
    """A probability after more evidence.

    >>> _believed(0.5, 0.0), round(_believed(0.5, 2.2), 2), _believed(1.0, -3.0)
    (0.5, 0.9, 1.0)
    """
    against = (1.0 - quality) * float(np.exp(-log_odds))
    return quality / (quality + against) if quality > 0.0 else 0.0


def absent(name: str, seconds: float = 0.0) -> PoseEstimate:
    """The answer for an object of which no pose stands."""
    return PoseEstimate(
        name, 0, False, None, 0.0, "LOST", 0.0, 0.0, None, None, None, None, None, (), seconds
    )
