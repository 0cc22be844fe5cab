"""Different poses in the order in which they are believed, each with what the judge says of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float64, Int64
from huepose.judge.figure_ground import PRIOR_CONTRAST, figure_ground_contrast
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel


@dataclass(frozen=True, eq=False)
class Ranked:
    """poses T_cam_obj (K, 4, 4), best first; totals (K,): of the judge; behind (K,): how far each is behind
    the first in all that orders them, in units of the total; 0 for the first, never less."""

    poses: Float64
    totals: Float64
    behind: Float64

    @classmethod
    def of(cls, poses: Float64, totals: Float64, scores: Float64 | None = None) -> Ranked:
        """Poses (K, 4, 4) and totals (K,) in any order, ranked by scores (K,), the totals where none are
        given."""
        scores = totals if scores is None else scores
        order = np.argsort(-scores, kind="stable")
        return cls(poses[order], totals[order], scores[order[:1]] - scores[order])

    def __len__(self) -> int:
        return len(self.poses)

    def these(self, indices: Sequence[int] | Int64) -> Ranked:
        """Some of them, the first among them."""
        kept = np.asarray(indices, dtype=np.int64)
        return Ranked(self.poses[kept], self.totals[kept], self.behind[kept])


NONE = Ranked(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0))
"""Where nothing was found."""


def by_figure(model: ReferenceModel, region: Region, found: Ranked, weight: float) -> Ranked:
    """Different poses in the order of totals and of how well they stand out from what is round them, which
    counts `weight`."""
    if len(found) < 2:
        return found
    totals = found.totals
    both = totals + weight * PRIOR_CONTRAST
    # Who cannot come first even if no colour of its ground is in its figure need not be looked at; nor who is
    # farther behind than hardly any pose gains by it.
    near = totals > totals[0] - weight * PRIOR_CONTRAST
    if near[1]:
        both[0] = totals[0] + weight * figure_ground_contrast(model, region, found.poses[:1])[0]
        asked = 1 + np.flatnonzero(near[1:] & (totals[1:] + weight > both[0]))
        both[asked] = totals[asked] + weight * figure_ground_contrast(model, region, found.poses[asked])
    return Ranked.of(found.poses, totals, both)
