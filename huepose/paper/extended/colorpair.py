"""The method `colorpair`: the paper's method with additions; no templates and no dense colour.

Per source mask: pairs > hypotheses (`paper.extended.hypotheses`), and start poses from shape if there are
few > registration on depth. Then for all masks together: near-symmetric rotations of the best poses >
coordinate search by pairs > registration on depth > fine search of the best ones. Pairs judge all poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.pairs import CLOSE_PAIRS, PairImage, pair_image
from huepose.judge.region import Region
from huepose.judge.texture_evidence import agreement_many
from huepose.model.types import ReferenceModel
from huepose.paper.extended.hypotheses import HypothesesConfig, hypotheses_of, read_scene
from huepose.paper.extended.pair_score import CLOSE_PAIR_SAMPLES, pair_score_many
from huepose.paper.extended.pair_search import search_pairs
from huepose.paper.extended.shape import shape_hypotheses
from huepose.paper.scene import extract_at_model_scale, warm_up_point_pairs
from huepose.paper.semantic_icp import semantic_icp_many
from huepose.paper.tables import tables_of
from huepose.propose.evidence import Evidence
from huepose.refine.point_to_plane import align_many
from huepose.select.distinct import FINAL_SHIFT, FINAL_TURN_RAD, NONE, Ranked, different_poses
from huepose.support.stages import stage

RIM_PX = 3
"""Side of the erosion kernel of masks, pixels: pairs at the rim of a mask also have colours of the
background."""

COARSE_PAIRS, COARSE_SAMPLES = 300, 200
SEARCH_PAIRS, SEARCH_SAMPLES = 600, 300
"""Largest numbers of pairs and surface samples that judge a pose; the last few poses are judged with more."""

CORRELATED, AGREED = 0.5, 0.5
"""Weights, in the final order, of the score's correlations and of the agreement, in which a pair that
disagrees counts as zero (`judge.texture_evidence.agreement_many`): chosen on rendered heaps."""


REFINED, SHAPES = 30, 20
"""Largest numbers of hypotheses of a mask that are registered, and of those among them that come from shape
alone, if colours propose too few."""

KEPT, WITH_NEAR_SYMMETRIES = 8, 5
"""Largest numbers of different poses after that, and of those whose near-symmetric rotations are tried."""

SEARCHED, FINISHED = 8, 3
"""Largest numbers of poses that are searched, and of those that are searched finely in the end."""

ALTERNATIVES = 6
"""Largest number of different poses that are returned."""


@dataclass(frozen=True)
class ColorpairPathConfig:
    """shapes: whether shape alone may propose start poses; semantic: whether semantic ICP adds a pose to each
    of the best different ones; hypotheses: which sources vote, and whether the light is estimated."""

    shapes: bool = True
    semantic: bool = True
    hypotheses: HypothesesConfig = field(default_factory=HypothesesConfig)


class ColorpairMethod:
    """The method `colorpair` as the estimator runs it."""

    bare = False

    def __init__(self, config: ColorpairPathConfig | None = None) -> None:
        self.config = config or ColorpairPathConfig()

    def check(self, model: ReferenceModel) -> None:
        """Raises InputError for a model without the tables of the paper's method."""
        tables_of(model)

    def warm_up(self, models: Sequence[ReferenceModel]) -> None:
        """Compile what the first image may not need, but a later one does."""
        if self.config.hypotheses.ppf:
            warm_up_point_pairs(models)

    def poses(self, model: ReferenceModel, evidence: Evidence, rng: np.random.Generator) -> Ranked:
        """See `estimate_by_pairs`."""
        return estimate_by_pairs(model, evidence, self.config, rng)


def estimate_by_pairs(
    model: ReferenceModel, evidence: Evidence, config: ColorpairPathConfig, rng: np.random.Generator
) -> Ranked:
    """Poses of one object, best first.

    Every source mask proposes poses; `pair_score` on the evidence's region scores them. Empty without any
    proposal: no depth, or neither pairs nor a plausible start pose from shape.
    """
    region = evidence.region
    with stage("image"):
        picture = pair_image(model, region.crop, region.median_depth_m)
    poses = proposed_by_pairs(model, evidence, picture, config, rng)
    if not len(poses):
        return NONE
    with stage("turns"):
        poses = _with_near_symmetries(model, region, picture, poses)
    with stage("search"):
        searched, _ = search_pairs(model, region, picture, poses, (8.0, 4.0, 2.0, 1.0))
    with stage("icp"):
        registered = align_many(model.surface, model.grid, region.points_cam, searched, 0.012, 0.006, 5)
        poses = np.concatenate([searched, registered])
    with stage("judge"):
        terms = _judge(model, region, picture, poses)
        most = ALTERNATIVES + FINISHED
        best = different_poses(model, poses, terms[:, 0], most, FINAL_TURN_RAD, FINAL_SHIFT)
        poses, terms = poses[best], terms[best]
    with stage("search"):
        fine, _ = search_pairs(
            model, region, picture, poses[:FINISHED], (3.0, 1.5, 0.7), SEARCH_PAIRS, SEARCH_SAMPLES
        )
        poses = np.concatenate([poses, fine])
        terms = np.concatenate([terms, _judge(model, region, picture, fine)])
        best = different_poses(model, poses, terms[:, 0], ALTERNATIVES, FINAL_TURN_RAD, FINAL_SHIFT)
    with stage("decide"):
        return _decided(model, region, picture, poses[best], terms[best])


def proposed_by_pairs(
    model: ReferenceModel,
    evidence: Evidence,
    picture: PairImage,
    config: ColorpairPathConfig,
    rng: np.random.Generator,
) -> Float64:
    """The best different poses (N, 4, 4) that the source masks propose, registered on the masks' points."""
    crop = evidence.region.crop
    part = RgbdFrame(np.ascontiguousarray(crop.color), np.ascontiguousarray(crop.depth), crop.camera)
    sources = zip(evidence.sources, evidence.points_cam, strict=True)
    poses = [_proposed(model, part, evidence.region, picture, m, p, rng, config) for m, p in sources]
    return np.concatenate([np.zeros((0, 4, 4)), *poses])


def _proposed(
    model: ReferenceModel,
    part: RgbdFrame,
    region: Region,
    picture: PairImage,
    source: Bool,
    points_cam: Float64,
    rng: np.random.Generator,
    config: ColorpairPathConfig,
) -> Float64:
    """The best different poses (N, 4, 4) that one source mask (h, w) proposes; `part`: the crop's frame."""
    mask = cv2.erode(source.astype(np.uint8), np.ones((RIM_PX, RIM_PX), np.uint8)) > 0
    with stage("extract"):
        pairs = extract_at_model_scale(model.pairs, part, mask)
    with stage("hypotheses"):
        readings = read_scene(model, pairs, part, mask, config.hypotheses, rng)
        found = hypotheses_of(model, readings, part, mask, config.hypotheses, rng)[:REFINED]
        if config.shapes:
            starts = shape_hypotheses(model, part, mask, min(REFINED - len(found), SHAPES))
            found = np.concatenate([found, starts])
    if not len(found):
        return found
    with stage("icp"):
        poses = align_many(model.surface, model.grid, points_cam, found, 0.15 * model.diameter_m, 0.008, 25)
    with stage("judge"):
        totals = pair_score_many(model, region, picture, poses, COARSE_PAIRS, COARSE_SAMPLES)[:, 0]
        poses = poses[different_poses(model, poses, totals, KEPT)]
    if config.semantic and readings:
        with stage("semantic_icp"):
            more = semantic_icp_many(tables_of(model), readings[0].cloud, poses)
            poses = np.concatenate([poses, more])
    return np.asarray(poses)


def _with_near_symmetries(
    model: ReferenceModel, region: Region, picture: PairImage, poses: Float64
) -> Float64:
    """The best different poses among poses (N, 4, 4) and the near-symmetric rotations of the best ones."""
    totals = pair_score_many(model, region, picture, poses, COARSE_PAIRS, COARSE_SAMPLES)[:, 0]
    best = different_poses(model, poses, totals, KEPT)
    poses, totals = poses[best], totals[best]
    near_symmetric = model.near_symmetric(poses[:WITH_NEAR_SYMMETRIES])
    if len(near_symmetric):
        more = pair_score_many(model, region, picture, near_symmetric, COARSE_PAIRS, COARSE_SAMPLES)[:, 0]
        poses, totals = np.concatenate([poses, near_symmetric]), np.concatenate([totals, more])
    return np.asarray(poses[different_poses(model, poses, totals, SEARCHED)])


def _decided(
    model: ReferenceModel, region: Region, picture: PairImage, poses: Float64, terms: Float64
) -> Ranked:
    """Different poses (K, 4, 4) with their terms (K, 5), ordered by correlation and by agreement."""
    totals, geometry = terms[:, 0], terms[:, 1]
    agreed = agreement_many(model, region, picture, poses)
    weighed = geometry + CORRELATED * (totals - geometry) + AGREED * agreed
    return Ranked.of(poses, totals, weighed)


def _judge(model: ReferenceModel, region: Region, picture: PairImage, poses: Float64) -> Float64:
    """Terms (M, 5) of `pair_score_many` of poses (M, 4, 4), with more pairs and samples."""
    return pair_score_many(model, region, picture, poses, CLOSE_PAIRS, CLOSE_PAIR_SAMPLES)
