"""A tracked pose that is plainly still right needs no search of all views: most of what live use costs.

The refined prior is held against its own near-symmetric rotations on the same pixels. When it scores high and
clearly better than they do, that is the answer; its margin counts no more than `margin` then, because nothing
else was looked at. A share of the frames is looked at in full all the same, so that a wrong pose that looks
right to itself is found out.
"""

from __future__ import annotations

import numpy as np

from huepose.estimation.config import ConfirmConfig
from huepose.geometry.arrays import Float64
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, score_many
from huepose.judge.terms import totals as totals_of
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import RACE, search
from huepose.select.distinct import FINAL_SHIFT, FINAL_TURN_RAD, different_poses


def looks_in_full(frame_id: int, every: int) -> bool:
    """Whether this is one of the frames, about one in `every`, that are searched whatever the prior says;
    spread irregularly, so that no rhythm of requests evades them. Always for 0 and 1."""
    return every <= 1 or (frame_id * 2654435761 >> 16) % every == 0


def confirm(
    model: ReferenceModel,
    region: Region,
    T_cam_obj: Float64,
    config: ConfirmConfig | None = None,
) -> tuple[Float64, Float64] | None:
    """The refined prior (4, 4) first, then its best different near-symmetric rotations: poses (K, 4, 4) and
    totals (K,); None when the prior is not plainly right."""
    config = config or ConfirmConfig()
    if totals_of(model, region, T_cam_obj[None])[0] < config.score:
        return None
    near_symmetric = T_cam_obj @ model.near_symmetries[1:]
    best = np.argsort(-score_many(model, region, near_symmetric, config.samples)[:, 0], kind="stable")[
        : config.near_symmetries
    ]
    searched, _ = search(model, region, near_symmetric[best], config.steps_deg, CLOSE_SAMPLES, race=RACE)
    poses = np.concatenate([T_cam_obj[None], searched])
    totals = totals_of(model, region, poses)
    order = different_poses(model, poses, totals, len(poses), FINAL_TURN_RAD, FINAL_SHIFT)
    if len(order) > 1 and (order[0] != 0 or totals[0] - totals[order[1]] < config.margin):
        return None
    return poses[order], totals[order]
