"""The full method: views retrieved under all candidate masks, refined on depth and texture, judged together.

Retrieval of views, without trust in the masks > ICP on the points of the mask that proposed it > near-
symmetric rotations of the best > coordinate search on the dense score > ICP > the best searched finely >
near ties looked at closely.

A tracked pose that is plainly still right needs no search of all views, most of what live use costs
(`confirm`). The refined prior is held against its own near-symmetric rotations on the same pixels. When it
scores high and clearly better than they do, that is the answer; its margin counts no more than `margin` then,
because nothing else was looked at. A share of the frames is looked at in full all the same, so that a wrong
pose that looks right to itself is found out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.estimation.config import ConfirmConfig, FullPathConfig
from huepose.geometry.arrays import Float, Float64
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, score_many
from huepose.judge.terms import totals as totals_of
from huepose.model.types import ReferenceModel
from huepose.propose.evidence import Evidence
from huepose.propose.template_table import TemplateTable, build_table
from huepose.propose.views import retrieve
from huepose.refine.coordinate_search import RACE, search
from huepose.refine.point_to_plane import align_many
from huepose.select.distinct import FINAL_SHIFT, FINAL_TURN_RAD, NONE, Ranked, different_poses
from huepose.support.kept import kept
from huepose.support.once import once_for_each
from huepose.support.stages import stage


@once_for_each
def table_of(model: ReferenceModel) -> TemplateTable:
    """A model's view templates laid out for retrieval, mapped as long as it is there."""
    return kept(TemplateTable, model.digest, lambda: build_table(model.templates, model.diameter_m))


@dataclass(frozen=True, eq=False)
class Trail:
    """What the steps left on the way to an answer: poses (N, 4, 4) of the views that were retrieved, of these
    after registration on depth, and of those that were searched."""

    retrieved: Float64
    registered: Float64
    searched: Float64


def estimate_full(
    model: ReferenceModel,
    evidence: Evidence,
    config: FullPathConfig,
    prior: Ranked = NONE,
) -> tuple[Ranked, Trail]:
    """Different poses, best first, and the way to them. prior: refined poses from elsewhere, judged in the
    evidence's region, that stand for selection with the others."""
    with stage("retrieval"):
        views = retrieve(table_of(model), evidence.picture, evidence.sources, config.retrieval)
    with stage("icp"):
        aligned = [
            _icp(model, points, views.poses[views.masks == k], 0.1 * model.diameter_m, 0.008, 12)
            for k, points in enumerate(evidence.points_cam)
        ]
    registered = np.concatenate(aligned)
    searched = refine_coarse(model, evidence.region, registered, config)
    found = finish(model, evidence.region, searched, config, prior)
    return found, Trail(views.poses, registered, searched)


def refine_coarse(model: ReferenceModel, region: Region, poses: Float64, config: FullPathConfig) -> Float64:
    """Aligned poses (N, 4, 4) brought home: near-symmetric rotations, search on the score, ICP (M, 4, 4)."""
    if not len(poses):
        return poses
    with stage("turns"):
        totals = score_many(model, region, poses, config.coarse_samples)[:, 0]
        best = different_poses(model, poses, totals, config.kept)
        poses, totals = poses[best], totals[best]
        near_symmetric = np.einsum(
            "nij,mjk->nmik", poses[: config.with_near_symmetries], model.near_symmetries[1:]
        ).reshape(-1, 4, 4)
        near_symmetric_totals = score_many(model, region, near_symmetric, config.coarse_samples)[:, 0]
        poses, totals = (
            np.concatenate([poses, near_symmetric]),
            np.concatenate([totals, near_symmetric_totals]),
        )
        poses = poses[different_poses(model, poses, totals, config.searched)]
    with stage("search"):
        searched, totals = search(model, region, poses, config.search_deg, config.samples, race=RACE)
    with stage("icp"):
        rivals = searched[totals > totals.max() - config.registered_within]
        registered = _icp(model, region.points_cam, rivals, 0.012, 0.006, 5)
    return np.concatenate([searched, registered])


def refine_prior(
    model: ReferenceModel, evidence: Evidence, T_cam_obj: Float, config: FullPathConfig | None = None
) -> Ranked:
    """A predicted pose (4, 4) brought onto the region: the best one of ICP and search from it."""
    config, region = config or FullPathConfig(), evidence.region
    start = np.asarray(T_cam_obj, dtype=np.float64)[None]
    aligned = [_icp(model, p, start, 0.15 * model.diameter_m, 0.008, 20) for p in evidence.points_cam]
    starts = np.concatenate([start, *aligned])
    searched, _ = search(model, region, starts, config.prior_deg, CLOSE_SAMPLES, race=RACE)
    registered = _icp(model, region.points_cam, searched, 0.012, 0.006, 5)
    poses = np.concatenate([starts, searched, registered])
    return Ranked.of(poses, totals_of(model, region, poses)).these([0])


def finish(
    model: ReferenceModel, region: Region, poses: Float64, config: FullPathConfig, prior: Ranked = NONE
) -> Ranked:
    """Judge refined poses (N, 4, 4), search the best finely, and return different ones, best first. prior:
    more of them, which were judged before."""
    if not len(poses) and not len(prior):
        return NONE
    with stage("judge"):
        totals = np.concatenate([prior.totals, totals_of(model, region, poses)])
        poses = np.concatenate([prior.poses, poses])
        best = different_poses(model, poses, totals, config.judged, FINAL_TURN_RAD, FINAL_SHIFT)
        poses, totals = poses[best], totals[best]
    with stage("search"):
        fine, fine_totals = search(
            model, region, poses[: config.finished], config.fine_deg, CLOSE_SAMPLES, race=RACE
        )
        poses, totals = np.concatenate([poses, fine]), np.concatenate([totals, fine_totals])
        best = different_poses(model, poses, totals, config.alternatives, FINAL_TURN_RAD, FINAL_SHIFT)
    return Ranked.of(poses[best], totals[best])


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


def _icp(
    model: ReferenceModel, points: Float64, poses: Float64, start_m: float, end_m: float, iterations: int
) -> Float64:
    return align_many(model.surface, model.grid, points, poses, start_m, end_m, iterations)
