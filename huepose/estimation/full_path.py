"""The full method: views retrieved for every candidate mask, refined on depth and print, judged together.

Per mask: retrieval of views > ICP > near-symmetric turns of the best > coordinate search on the dense score
> ICP. Then all poses are judged by all masks (a wrong mask finds few friends), and the best are searched
finely. What the measured ablation says of the steps is in the documentation of the estimator.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.estimation.config import FullPathConfig
from huepose.estimation.different import different_poses
from huepose.geometry.arrays import Bool, Float, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.matching.retrieval import TemplateTable, lab_of, retrieve
from huepose.model.types import ReferenceModel
from huepose.registration.surface_icp import align_many
from huepose.support.stages import stage
from huepose.verification.dense import score_many
from huepose.verification.local_search import search
from huepose.verification.region import Region, object_window, prepare_crop, prepare_masked

COARSE_SAMPLES, SEARCH_SAMPLES, FINE_SAMPLES = 350, 220, 800
FINAL_TURN_RAD, FINAL_SHIFT = 0.2, 0.05
"""Poses closer than this (shift in diameters) are one answer."""


def prepare_regions(frame: RgbdFrame, masks: list[Bool], box: Box, diameter_m: float) -> list[Region]:
    """One region a mask that has depth, all on one crop."""
    windows = [w for w in (object_window(frame, m, diameter_m) for m in masks) if w is not None]
    if not windows:
        return []
    left, top = min(w.x for w in windows), min(w.y for w in windows)
    right, bottom = max(w.x1 for w in windows), max(w.y1 for w in windows)
    crop = prepare_crop(frame, Box(left, top, right - left, bottom - top))
    regions = (prepare_masked(crop, m, box, diameter_m) for m in masks)
    return [r for r in regions if r is not None]


def judge(model: ReferenceModel, regions: Sequence[Region], poses: Float64) -> Float64:
    """Mean total (M,) of poses (M, 4, 4) over all regions."""
    return judge_terms(model, regions, poses)[:, 0]


def judge_terms(model: ReferenceModel, regions: Sequence[Region], poses: Float64) -> Float64:
    """Mean of all terms (M, 8) over all regions, columns as the fields of PoseScore."""
    terms = [score_many(model, region, poses, FINE_SAMPLES) for region in regions]
    return np.asarray(np.mean(terms, axis=0))


def estimate_full(
    model: ReferenceModel,
    table: TemplateTable,
    regions: list[Region],
    config: FullPathConfig,
    extra: Float64,
) -> tuple[Float64, Float64]:
    """Different poses (K, 4, 4) and their mean totals (K,), best first. `extra` (E, 4, 4): refined poses from
    elsewhere, judged with the others."""
    refined = [extra]
    crop = regions[0].crop
    with stage("retrieval"):
        lab = lab_of(crop.color)
    for region in regions:
        with stage("retrieval"):
            views, _ = retrieve(table, lab, crop.depth, region.mask, crop.camera, config.retrieved)
        refined.append(refine_coarse(model, region, views, config))
    return finish(model, regions, np.concatenate(refined), config)


def refine_coarse(model: ReferenceModel, region: Region, poses: Float64, config: FullPathConfig) -> Float64:
    """Rough poses (N, 4, 4) brought home: ICP, near-symmetric turns, search on the score, ICP (M, 4, 4)."""
    if not len(poses):
        return poses
    with stage("icp"):
        poses = _icp(model, region, poses, 0.2 * model.diameter_m, 0.008, 25)
    with stage("turns"):
        totals = score_many(model, region, poses, COARSE_SAMPLES)[:, 0]
        best = different_poses(model, poses, totals, config.kept)
        poses, totals = poses[best], totals[best]
        turned = np.einsum("nij,mjk->nmik", poses[: config.turned], model.turns[1:]).reshape(-1, 4, 4)
        turned_totals = score_many(model, region, turned, COARSE_SAMPLES)[:, 0]
        poses, totals = np.concatenate([poses, turned]), np.concatenate([totals, turned_totals])
        poses = poses[different_poses(model, poses, totals, config.searched)]
    with stage("search"):
        searched, _ = search(model, region, poses, (8.0, 4.0, 2.0, 1.0), SEARCH_SAMPLES)
    with stage("icp"):
        settled = _icp(model, region, searched, 0.012, 0.006, 5)
    return np.concatenate([searched, settled])


def refine_prior(model: ReferenceModel, regions: list[Region], T_cam_obj: Float) -> Float64:
    """A predicted pose (4, 4) brought onto each region; the best of these by all regions."""
    found = [np.asarray(T_cam_obj, dtype=np.float64)[None]]
    for region in regions:
        aligned = _icp(model, region, found[0], 0.15 * model.diameter_m, 0.008, 20)
        searched, _ = search(
            model, region, np.concatenate([found[0], aligned]), (4.0, 2.0, 1.0), FINE_SAMPLES
        )
        found += [searched, _icp(model, region, searched, 0.012, 0.006, 5)]
    poses = np.concatenate(found)
    return np.asarray(poses[np.argmax(judge(model, regions, poses))])


def finish(
    model: ReferenceModel, regions: list[Region], poses: Float64, config: FullPathConfig
) -> tuple[Float64, Float64]:
    """Judge refined poses (N, 4, 4) by all masks, search the best finely, and return different ones, best
    first."""
    if not len(poses):
        return poses, np.zeros(0)
    with stage("judge"):
        totals = judge(model, regions, poses)
        best = different_poses(model, poses, totals, config.judged, FINAL_TURN_RAD, FINAL_SHIFT)
        poses, totals = poses[best], totals[best]
    with stage("search"):
        fine = np.concatenate(
            [search(model, r, poses[: config.finished], (3.0, 1.5, 0.7), FINE_SAMPLES)[0] for r in regions]
        )
    with stage("judge"):
        poses, totals = np.concatenate([poses, fine]), np.concatenate([totals, judge(model, regions, fine)])
        best = different_poses(model, poses, totals, config.alternatives, FINAL_TURN_RAD, FINAL_SHIFT)
    return poses[best], totals[best]


def _icp(
    model: ReferenceModel, region: Region, poses: Float64, start_m: float, end_m: float, iterations: int
) -> Float64:
    return align_many(model.surface, model.grid, region.points_cam, poses, start_m, end_m, iterations)
