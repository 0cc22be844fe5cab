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
from huepose.select.distinct import different_answers
from huepose.select.ranked import Ranked

TERMS = tuple(term.name for term in fields(NearTieWeights))
"""What contenders are told apart by, see `NearTieWeights`."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Contenders for an answer: poses (K, 4, 4), refined by the close look, and of each its TERMS (K, 4)."""

    poses: Float64
    terms: Float64

    def weighed(self, weights: NearTieWeights | None = None) -> Float64:
        """Sums (K,) of the terms, each with its weight."""
        return np.asarray(self.terms @ np.array(astuple(weights or NearTieWeights())))


def contest(
    model: ReferenceModel, region: Region, found: Ranked, config: NearTieConfig | None = None
) -> Contest | None:
    """The best few of different poses looked at closely; None where one is clearly ahead, or one cannot be
    looked at."""
    config = config or NearTieConfig()
    rivals = int((found.behind[: config.contenders] < config.within).sum())
    if rivals < 2:
        return None
    poses = found.poses[:rivals]
    look = close_look(model, region, poses, config.close)
    if look is None:
        return None
    alike, pairs = look.alike, pair_colors(model, region, poses, config)
    columns = [-found.behind[:rivals], alike.detail, alike.broad, pairs]
    return Contest(look.poses, np.stack(columns, axis=-1))


def decided(
    model: ReferenceModel, region: Region, found: Ranked, config: NearTieConfig | None = None
) -> tuple[Ranked, Contest | None]:
    """Different poses after the best few were looked at closely, and the contest where there was one."""
    config = config or NearTieConfig()
    held = contest(model, region, found, config)
    if held is None:
        return found, None
    rivals, weighed = len(held.poses), held.weighed(config.weights)
    poses = np.concatenate([held.poses, found.poses[rivals:]])
    totals = np.concatenate([totals_of(model, region, held.poses), found.totals[rivals:]])
    others = np.maximum(found.behind[rivals:], config.within)
    ranked = Ranked.of(poses, totals, np.concatenate([config.share * (weighed - weighed.max()), -others]))
    return ranked.these(different_answers(model, ranked.poses)), held


def pair_colors(
    model: ReferenceModel, region: Region, poses: Float64, config: NearTieConfig | None = None
) -> Float64:
    """How well the colours of the model's pairs agree at poses (K, 4, 4), 0 without pairs: (K,)."""
    config = config or NearTieConfig()
    picture = pair_picture(model, region.crop, region.median_depth_m)
    terms = pair_score_many(model, region, picture, poses, config.pairs, config.pair_samples)
    weights = DEFAULT_PAIR_WEIGHTS
    return np.asarray(weights.color * terms[:, 2] + weights.contrast * terms[:, 3])
