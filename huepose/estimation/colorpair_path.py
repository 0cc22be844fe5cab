"""The paper's path to a pose: colour pairs alone, without templates and without dense colour.

Per candidate mask: pairs > hypotheses (matching.hypotheses) > registration on depth > near-symmetric turns
of the best > verification and coordinate search by pairs. Then all masks judge all poses together.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.estimation.config import ColorpairPathConfig
from huepose.estimation.different import different_poses
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.matching.hypotheses import (
    HypothesesConfig,
    colorpair_hypotheses,
    extract_at_model_scale,
)
from huepose.matching.shape import shape_hypotheses
from huepose.model.types import ReferenceModel
from huepose.registration.surface_icp import align_many
from huepose.support.stages import stage
from huepose.verification.pairs import PairPicture, pair_picture, pair_score_many
from huepose.verification.pairs_search import search_pairs
from huepose.verification.region import Region, object_window, prepare_crop, prepare_masked

RIM_PX = 3
"""Side of the square by which a mask is made smaller: pairs at its rim belong to what is behind, too."""

FINAL_PAIRS, FINAL_SAMPLES = 1500, 600
"""How closely the last few poses are looked at."""

SHAPES = 20
"""Most starts from shape alone, where colours propose too few poses."""


def estimate_by_pairs(
    model: ReferenceModel,
    frame: RgbdFrame,
    masks: Sequence[Bool],
    config: ColorpairPathConfig,
    rng: np.random.Generator,
) -> list[tuple[float, Float64]]:
    """Poses T_cam_obj (4, 4) of one object under candidate masks (H, W), with their scores, best first.

    The score is that of `verification.pairs`, averaged over the masks. Empty when nothing is to be seen: no
    depth under the masks, no pairs, or a model without pairs.
    """
    with stage("regions"):
        regions = _regions(frame, masks, model.diameter_m)
    if not regions:
        return []
    with stage("regions"):
        picture = pair_picture(model, frame, regions[0].crop, regions[0].median_depth_m)
    poses = [_from_mask(model, frame, region, picture, rng, config) for region in regions]
    found = np.concatenate(poses)
    if not len(found):
        return []
    with stage("judge"):
        totals = _judge(model, regions, picture, found)
        best = different_poses(model, found, totals, config.alternatives + config.finished, 0.2, 0.05)
        found, totals = found[best], totals[best]
    with stage("search"):
        fine = np.concatenate(
            [
                search_pairs(model, r, picture, found[: config.finished], (3.0, 1.5, 0.7), 600, 300)[0]
                for r in regions
            ]
        )
        found = np.concatenate([found, fine])
        totals = np.concatenate([totals, _judge(model, regions, picture, fine)])
    best = different_poses(model, found, totals, config.alternatives, 0.2, 0.05)
    return [(float(totals[k]), found[k]) for k in best]


def _regions(frame: RgbdFrame, masks: Sequence[Bool], diameter_m: float) -> list[Region]:
    """One region a mask that has depth, all on one crop."""
    seen = [(m, w) for m in masks if (w := object_window(frame, m, diameter_m)) is not None]
    if not seen:
        return []
    left, top = min(w.x for _, w in seen), min(w.y for _, w in seen)
    right, bottom = max(w.x1 for _, w in seen), max(w.y1 for _, w in seen)
    crop = prepare_crop(frame, Box(left, top, right - left, bottom - top))
    boxes = [Box.of_mask(m) for m, _ in seen]
    regions = [prepare_masked(crop, m, b, diameter_m) for (m, _), b in zip(seen, boxes, strict=True) if b]
    return [r for r in regions if r is not None]


def _judge(model: ReferenceModel, regions: list[Region], picture: PairPicture, poses: Float64) -> Float64:
    """Mean total (M,) of poses (M, 4, 4) over all regions."""
    return np.asarray(
        np.mean(
            [pair_score_many(model, r, picture, poses, FINAL_PAIRS, FINAL_SAMPLES)[:, 0] for r in regions],
            axis=0,
        )
    )


def _from_mask(
    model: ReferenceModel,
    frame: RgbdFrame,
    region: Region,
    picture: PairPicture,
    rng: np.random.Generator,
    config: ColorpairPathConfig,
) -> Float64:
    """Refined poses (N, 4, 4) from one mask."""
    d = model.diameter_m
    mask = np.zeros(frame.depth.shape, np.bool_)
    h, w = region.mask.shape
    x0, y0 = region.crop.x0, region.crop.y0
    inner = cv2.erode(region.mask.astype(np.uint8), np.ones((RIM_PX, RIM_PX), np.uint8))
    mask[y0 : y0 + h, x0 : x0 + w] = inner > 0
    with stage("extract"):
        pairs = extract_at_model_scale(model.pairs, frame, mask)
    with stage("hypotheses"):
        sources = HypothesesConfig() if config.ppf else HypothesesConfig(ppf=None)
        hypotheses = colorpair_hypotheses(model, pairs, frame, mask, sources, rng)
        hypotheses = hypotheses[: config.refined]
        hypotheses += shape_hypotheses(model, frame, mask, min(config.refined - len(hypotheses), SHAPES))
    if not hypotheses:
        return np.zeros((0, 4, 4))
    poses = np.stack([h.T_cam_obj for h in hypotheses])
    with stage("icp"):
        poses = align_many(model.surface, model.grid, region.points_cam, poses, 0.15 * d, 0.008, 25)
    with stage("judge"):
        totals = pair_score_many(model, region, picture, poses, 300, 200)[:, 0]
        best = different_poses(model, poses, totals, config.kept)
        poses, totals = poses[best], totals[best]
        turned = [T @ turn for T in poses[: config.turned] for turn in model.turns[1:]]
        if turned:
            turns = np.stack(turned)
            poses = np.concatenate([poses, turns])
            totals = np.concatenate([totals, pair_score_many(model, region, picture, turns, 300, 200)[:, 0]])
        poses = poses[different_poses(model, poses, totals, config.searched)]
    with stage("search"):
        searched, _ = search_pairs(model, region, picture, poses, (8.0, 4.0, 2.0, 1.0))
    with stage("icp"):
        settled = align_many(model.surface, model.grid, region.points_cam, searched, 0.012, 0.006, 5)
    return np.concatenate([searched, settled])
