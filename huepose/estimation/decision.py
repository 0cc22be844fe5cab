"""Which of the poses that score nearly alike is it? All that tells them apart is weighed together.

Rolls of a can, the two faces of a box, a marker's sides share shape and mean colours, and the dense score
hardly tells them apart. Then the few best are looked at closely (`verification.contest`), and more is weighed
with it: what the close look says of each, how well the print's detail and its broader parts explain the same
pixels and how much of the pose is open to view (`verification.same_pixels`), and how well the colour pairs
agree.
"""

from __future__ import annotations

import numpy as np

from huepose.estimation.different import different_poses
from huepose.estimation.full_path import FINAL_SHIFT, FINAL_TURN_RAD, judge
from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.verification.contest import close_look
from huepose.verification.pairs import DEFAULT_PAIR_WEIGHTS, pair_picture, pair_score_many
from huepose.verification.region import Region

CONTENDERS, WITHIN = 4, 0.12
"""So many poses look closely at each other, if their totals are within this of the best."""

CLOSE, DETAIL, BROAD, OPEN, PAIRS = 0.6, 1.5, 5.0, 1.8, 0.5
"""What the close look's total, detail, broader print, what is open to view and pairs' colours count beside
the dense score: near the largest likelihood that the right one of the contenders wins (a softmax of their
weighted sums), over drawn heaps, path-traced piles and real frames."""

SHARE = 0.35
"""A difference so weighed says as much as this part of it where nothing but the dense score is known."""

PAIRS_COUNT, SAMPLES = 1500, 600


def decided(
    model: ReferenceModel, region: Region, poses: Float64, totals: Float64, pairs: float = PAIRS
) -> tuple[Float64, Float64]:
    """Different poses (K, 4, 4) and their dense totals (K,), best first, after the best few were looked at
    closely. `pairs` is what colour pairs count.

    The winner's total is that of the dense score; the others' say how far they are behind.
    """
    rivals = int((totals[:CONTENDERS] > totals[0] - WITHIN).sum()) if len(totals) else 0
    if rivals < 2:
        return poses, totals
    look = close_look(model, region, poses[:rivals])
    if look is None:
        return poses, totals
    alike = look.alike
    weighed = totals[:rivals] + CLOSE * look.totals
    weighed += DETAIL * alike.detail + BROAD * alike.broad + OPEN * alike.open
    if pairs > 0.0:
        weighed += pairs * pair_colors(model, region, poses[:rivals])
    winner = int(np.argmax(weighed))
    top = float(judge(model, region, look.poses[winner : winner + 1])[0])
    every = np.concatenate([look.poses, poses[rivals:]])
    behind = SHARE * (weighed[winner] - weighed)
    behind = np.concatenate([behind, np.maximum(totals[0] - totals[rivals:], WITHIN)])
    order = different_poses(model, every, -behind, len(every), FINAL_TURN_RAD, FINAL_SHIFT)
    return every[order], top - behind[order]


def pair_colors(model: ReferenceModel, region: Region, poses: Float64) -> Float64:
    """How well the colours of the model's pairs agree at poses (K, 4, 4), 0 without pairs: (K,)."""
    picture = pair_picture(model, region.crop, region.median_depth_m)
    terms = pair_score_many(model, region, picture, poses, PAIRS_COUNT, SAMPLES)
    weights = DEFAULT_PAIR_WEIGHTS
    return np.asarray(weights.color * terms[:, 2] + weights.contrast * terms[:, 3])
