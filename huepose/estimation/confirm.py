"""A tracked pose that is plainly still right needs no search of all views: most of what live use costs.

The refined prior is held against its own near-symmetric rotations on the same pixels. When it scores high and
clearly better than they do, that is the answer; its margin counts no more than `margin` then, because nothing
else was looked at. A share of the frames is looked at in full all the same, so that a wrong pose that looks
right to itself is found out.
"""

from __future__ import annotations

import numpy as np

from huepose.estimation.config import ConfirmConfig
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, score_many
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import RACE, search
from huepose.select.distinct import FINAL_SHIFT, FINAL_TURN_RAD, different_poses
from huepose.select.ranked import Ranked


def looks_in_full(frame_id: int, every: int) -> bool:
    """Whether this is one of the frames, about one in `every`, that are searched whatever the prior says;
    spread irregularly, so that no rhythm of requests evades them. Always for 0 and 1."""
    return every <= 1 or (frame_id * 2654435761 >> 16) % every == 0


def confirm(
    model: ReferenceModel, region: Region, prior: Ranked, config: ConfirmConfig | None = None
) -> Ranked | None:
    """The refined prior first, then its best different near-symmetric rotations; None when the prior is not
    plainly right."""
    config = config or ConfirmConfig()
    if prior.totals[0] < config.score:
        return None
    rotated = prior.poses[0] @ model.near_symmetries[1:]
    first = score_many(model, region, rotated, config.samples)[:, 0]
    best = np.argsort(-first, kind="stable")[: config.near_symmetries]
    searched, totals = search(model, region, rotated[best], config.steps_deg, CLOSE_SAMPLES, race=RACE)
    poses, totals = np.concatenate([prior.poses, searched]), np.concatenate([prior.totals, totals])
    order = different_poses(model, poses, totals, len(poses), FINAL_TURN_RAD, FINAL_SHIFT)
    if len(order) > 1 and (order[0] != 0 or totals[0] - totals[order[1]] < config.margin):
        return None
    return Ranked.of(poses[order], totals[order])
