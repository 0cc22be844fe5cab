"""One surface, one pose: the poses of one frame compete for its depth pixels.

Poses are taken in order of their quality. A sure one keeps the pixels that it explains; a later one that
lives on such pixels, or is doubtful beside them, is looked for again in the frame without them. What was
taken counts as "no reading" there: it speaks neither for a pose nor against it, as something in front does.
So neighbours in a pile, which merge into one mask, are told apart by those of them that are recognised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from huepose.estimation.config import CompetitionConfig
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry.arrays import Bool
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame

LookAgain = Callable[[RgbdFrame, ObjectQuery], PoseEstimate]


def compete(
    frame: RgbdFrame,
    queries: Sequence[ObjectQuery],
    answers: Sequence[PoseEstimate],
    look_again: LookAgain,
    config: CompetitionConfig | None = None,
) -> list[PoseEstimate]:
    """Answers, in the order of the queries, of which no two explain the same surface.

    `look_again` estimates a query in a frame from whose depth that of surer poses was taken away. A pose that
    lived on it gives way to what is found then; one that was only doubtful does so when that is surer.
    """
    config, out = config or CompetitionConfig(), list(answers)
    before: list[PoseEstimate] = []
    for k in sorted(range(len(out)), key=lambda i: _rank(out[i])):
        sure = [o for o in before if o.quality >= config.sure or o.object == out[k].object]
        taken = np.any([o.mask for o in sure if o.mask is not None] or [np.zeros(frame.depth.shape, bool)], 0)
        out[k] = _without(frame, queries[k], out[k], taken, look_again, config)
        before.append(out[k])
    return out


def _rank(answer: PoseEstimate) -> tuple[float, float, str, int]:
    """Surest first, whatever the order of the queries."""
    return -answer.quality, -answer.score, answer.object, answer.instance


def _without(
    frame: RgbdFrame,
    query: ObjectQuery,
    answer: PoseEstimate,
    taken: Bool,
    look_again: LookAgain,
    config: CompetitionConfig,
) -> PoseEstimate:
    """The answer, or what is found instead where it may not use the pixels that are taken."""
    contested = _share_of_mask(answer.mask, taken) > config.contested
    doubtful = answer.quality < config.doubtful and _share_of_box(query.box, taken) > config.taken
    if not contested and not doubtful:
        return answer
    free = replace(frame, depth=np.where(taken, np.float32(0.0), frame.depth))
    masks = tuple(np.asarray(m, bool) & ~taken for m in query.masks)
    again = look_again(free, replace(query, masks=masks))
    again = replace(again, seconds=again.seconds + answer.seconds)
    return again if contested or again.quality > answer.quality else answer


def _share_of_mask(mask: Bool | None, taken: Bool) -> float:
    size = 0 if mask is None else np.count_nonzero(mask)
    return 0.0 if mask is None or size == 0 else np.count_nonzero(mask & taken) / size


def _share_of_box(box: Box | None, taken: Bool) -> float:
    if box is None:
        return 0.0
    height, width = taken.shape
    inside = taken[box.slices(width, height)]
    return float(inside.mean()) if inside.size else 0.0
