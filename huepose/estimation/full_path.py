"""The full method: views retrieved under all candidate masks, refined on depth and texture, judged together.

Retrieval of views, without trust in the masks > ICP on the points of the mask that proposed it > near-
symmetric rotations of the best > coordinate search on the dense score > ICP > the best searched finely > in
the order of score and of how well figure and ground differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.estimation.config import FullPathConfig
from huepose.geometry.arrays import Float, Float64
from huepose.judge.figure_ground import PRIOR_CONTRAST, figure_ground_contrast
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, score_many
from huepose.judge.terms import totals as totals_of
from huepose.model.types import ReferenceModel
from huepose.propose.evidence import Evidence, doubted
from huepose.propose.template_table import TemplateTable
from huepose.propose.views import retrieve
from huepose.refine.coordinate_search import RACE, search
from huepose.refine.point_to_plane import align_many
from huepose.select.distinct import FINAL_SHIFT, FINAL_TURN_RAD, different_poses
from huepose.support.stages import stage


@dataclass(frozen=True, eq=False)
class Trail:
    """What the steps left on the way to an answer: poses (N, 4, 4) of the views that were retrieved, of these
    after registration on depth, and of those that were searched."""

    retrieved: Float64
    registered: Float64
    searched: Float64


def estimate_full(
    model: ReferenceModel,
    table: TemplateTable,
    evidence: Evidence,
    config: FullPathConfig,
    extra: Float64,
    look_harder: bool = True,
) -> tuple[Float64, Float64, Trail, Evidence]:
    """Different poses (K, 4, 4) and their totals (K,), best first, the way to them, and the evidence as it
    was believed in the end. `extra` (E, 4, 4): refined poses from elsewhere, judged with the others. Where
    only a poor one is found, it may be looked harder, and the masks are doubted: what is thin or lies half
    under its neighbours often has masks that mislead registration, or that show the neighbours."""
    poses, totals, trail = _look(model, table, evidence, config, extra)
    if not look_harder or (len(totals) and totals[0] >= config.poor):
        return poses, totals, trail, evidence
    evidence = doubted(evidence)
    return *_look(model, table, evidence, config.harder(), np.concatenate([extra, poses])), evidence


def _look(
    model: ReferenceModel, table: TemplateTable, evidence: Evidence, config: FullPathConfig, extra: Float64
) -> tuple[Float64, Float64, Trail]:
    with stage("retrieval"):
        views = retrieve(table, evidence.picture, evidence.sources, config.retrieval)
    with stage("icp"):
        aligned = [
            _icp(model, points, views.poses[views.masks == k], 0.1 * model.diameter_m, 0.008, 12)
            for k, points in enumerate(evidence.points_cam)
        ]
    registered = np.concatenate([*aligned, views.poses] if config.unregistered else aligned)
    searched = refine_coarse(model, evidence.region, registered, config)
    poses, totals = finish(model, evidence.region, np.concatenate([extra, searched]), config)
    return poses, totals, Trail(views.poses, registered, searched)


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
) -> Float64:
    """A predicted pose (4, 4) brought onto the region: the best of ICP and search from it."""
    config, region = config or FullPathConfig(), evidence.region
    start = np.asarray(T_cam_obj, dtype=np.float64)[None]
    aligned = [_icp(model, p, start, 0.15 * model.diameter_m, 0.008, 20) for p in evidence.points_cam]
    starts = np.concatenate([start, *aligned])
    searched, _ = search(model, region, starts, config.prior_deg, CLOSE_SAMPLES, race=RACE)
    registered = _icp(model, region.points_cam, searched, 0.012, 0.006, 5)
    poses = np.concatenate([starts, searched, registered])
    return np.asarray(poses[np.argmax(totals_of(model, region, poses))])


def finish(
    model: ReferenceModel, region: Region, poses: Float64, config: FullPathConfig
) -> tuple[Float64, Float64]:
    """Judge refined poses (N, 4, 4), search the best finely, and return different ones, best first."""
    if not len(poses):
        return poses, np.zeros(0)
    with stage("judge"):
        totals = totals_of(model, region, poses)
        best = different_poses(model, poses, totals, config.judged, FINAL_TURN_RAD, FINAL_SHIFT)
        poses, totals = poses[best], totals[best]
    with stage("search"):
        fine, fine_totals = search(
            model, region, poses[: config.finished], config.fine_deg, CLOSE_SAMPLES, race=RACE
        )
        poses, totals = np.concatenate([poses, fine]), np.concatenate([totals, fine_totals])
        best = different_poses(model, poses, totals, config.alternatives, FINAL_TURN_RAD, FINAL_SHIFT)
    with stage("judge"):
        return by_figure(model, region, poses[best], totals[best], config)


def by_figure(
    model: ReferenceModel,
    region: Region,
    poses: Float64,
    totals: Float64,
    config: FullPathConfig | None = None,
) -> tuple[Float64, Float64]:
    """Different poses (K, 4, 4) and totals (K,), best first, in the order of totals and of how well they
    stand out from what is round them. The first keeps its total, the others' say how far they are behind."""
    if len(poses) < 2:
        return poses, totals
    config = config or FullPathConfig()
    weight = config.figure_weight
    both = totals + weight * PRIOR_CONTRAST
    # Who cannot come first even if no colour of its ground is in its figure need not be looked at.
    near = totals > totals[0] - config.figure_within
    if near[1]:
        both[0] = totals[0] + weight * figure_ground_contrast(model, region, poses[:1])[0]
        asked = 1 + np.flatnonzero(near[1:] & (totals[1:] + weight > both[0]))
        both[asked] = totals[asked] + weight * figure_ground_contrast(model, region, poses[asked])
    order = np.argsort(-both, kind="stable")
    return poses[order], totals[order[0]] - (both[order[0]] - both[order])


def _icp(
    model: ReferenceModel, points: Float64, poses: Float64, start_m: float, end_m: float, iterations: int
) -> Float64:
    return align_many(model.surface, model.grid, points, poses, start_m, end_m, iterations)
