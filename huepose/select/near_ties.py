"""Which of the poses that score nearly alike is it? All that tells them apart is weighed together.

Rolls of a can, the two faces of a box, a marker's sides share shape and mean colours, and the dense score
hardly tells them apart. Then the few best are looked at closely (`select.close_look`), compared on the
same pixels (`judge.same_pixels`) and by colour pairs, and all of it is weighed together.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.judge.pair_terms import DEFAULT_PAIR_WEIGHTS, pair_picture, pair_score_many
from huepose.judge.region import Region
from huepose.judge.terms import totals as totals_of
from huepose.model.types import ReferenceModel
from huepose.select.close_look import close_look
from huepose.select.config import NearTieConfig, NearTieWeights
from huepose.select.distinct import FINAL_SHIFT, FINAL_TURN_RAD, different_poses

TERMS = tuple(term.name for term in fields(NearTieWeights))
"""What contenders are told apart by, see `NearTieWeights`."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Contenders for an answer: poses (K, 4, 4), refined by the close look, and of each its TERMS (K, 6)."""

    poses: Float64
    terms: Float64

    def weighed(self, weights: NearTieWeights | None = None) -> Float64:
        """Sums (K,) of the terms, each with its weight."""
        return np.asarray(self.terms @ np.array(astuple(weights or NearTieWeights())))


def contest(
    model: ReferenceModel,
    region: Region,
    poses: Float64,
    totals: Float64,
    config: NearTieConfig | None = None,
) -> Contest | None:
    """The best few of different poses (K, 4, 4) with their dense totals (K,), best first, looked at closely;
    None where one is clearly ahead, or one cannot be looked at."""
    config = config or NearTieConfig()
    near = totals[: config.contenders] > totals[:1] - config.within
    rivals = int(near.sum())
    if rivals < 2:
        return None
    look = close_look(model, region, poses[:rivals], config.close)
    if look is None:
        return None
    alike, pairs = look.alike, pair_colors(model, region, poses[:rivals], config)
    columns = [totals[:rivals], look.totals, alike.detail, alike.broad, alike.open, pairs]
    return Contest(look.poses, np.stack(columns, axis=-1))


def decided(
    model: ReferenceModel,
    region: Region,
    poses: Float64,
    totals: Float64,
    config: NearTieConfig | None = None,
) -> tuple[Float64, Float64, Contest | None]:
    """Different poses (K, 4, 4) and their dense totals (K,), best first, after the best few were looked at
    closely, and the contest where there was one.

    The winner's total is that of the dense score; the others' say how far they are behind.
    """
    config = config or NearTieConfig()
    held = contest(model, region, poses, totals, config)
    if held is None:
        return poses, totals, None
    rivals, weighed = len(held.poses), held.weighed(config.weights)
    winner = int(np.argmax(weighed))
    top = float(totals_of(model, region, held.poses[winner : winner + 1])[0])
    every = np.concatenate([held.poses, poses[rivals:]])
    behind = config.share * (weighed[winner] - weighed)
    behind = np.concatenate([behind, np.maximum(totals[0] - totals[rivals:], config.within)])
    order = different_poses(model, every, -behind, len(every), FINAL_TURN_RAD, FINAL_SHIFT)
    return every[order], top - behind[order], held


def pair_colors(
    model: ReferenceModel, region: Region, poses: Float64, config: NearTieConfig | None = None
) -> Float64:
    """How well the colours of the model's pairs agree at poses (K, 4, 4), 0 without pairs: (K,)."""
    config = config or NearTieConfig()
    picture = pair_picture(model, region.crop, region.median_depth_m)
    terms = pair_score_many(model, region, picture, poses, config.pairs, config.pair_samples)
    weights = DEFAULT_PAIR_WEIGHTS
    return np.asarray(weights.color * terms[:, 2] + weights.contrast * terms[:, 3])
