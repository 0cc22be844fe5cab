"""The estimate of one object: evidence > propose > refine > judge > select > believe, in `answered`.

The full method retrieves views under all candidate masks, because no mask can be trusted, and refines them:
ICP on the points of the mask that proposed each view > near-symmetric rotations of the best > coordinate
search on the dense score > ICP. The best poses are searched finely, near ties are compared once more, and the
first pose is fitted to depth and edges.

If a tracked pose, given as a prior, is clearly still right, the search of all views is skipped (`confirm`);
it is most of the cost of live use. The refined prior is compared with its own near-symmetric rotations on the
same pixels. If its score is high and clearly better than theirs, it is the estimate. Its margin then counts
at most CLEAR_MARGIN, because nothing else was searched. A share of the frames is searched in full all the
same, so that a wrong pose that confirms itself is detected.
"""

from __future__ import annotations

import time
from dataclasses import replace
from zlib import crc32

import numpy as np

from huepose.believe.quality import QualityTerms, quality_fits
from huepose.believe.state import State
from huepose.estimation.config import EstimatorConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.methods import PairMethod
from huepose.estimation.reasons import why_absent, why_unseen
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64, Int64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.judge.pairs import pair_image
from huepose.judge.region import Region
from huepose.judge.silhouette import projected_box, visible_mask
from huepose.judge.terms import CLOSE_SAMPLES, score, score_many
from huepose.judge.terms import totals as totals_of
from huepose.judge.texture_evidence import agreement_many, contrast_disagreement, texture_evidence
from huepose.model.types import ReferenceModel
from huepose.perception.types import Segmenter
from huepose.propose.evidence import Evidence, gather
from huepose.propose.templates import table_of
from huepose.propose.views import retrieve
from huepose.refine.coordinate_search import RACE, search
from huepose.refine.final import covariance, final_refinement, scale_residual
from huepose.refine.point_to_plane import align_many
from huepose.select.distinct import (
    FINAL_SHIFT,
    FINAL_TURN_RAD,
    NONE,
    Ranked,
    different_answers,
    different_poses,
)
from huepose.select.near_ties import decided
from huepose.select.shade import in_their_light
from huepose.support.errors import InputError
from huepose.support.pool import Steps
from huepose.support.stages import stage

# How much the full method tries. Chosen with `huepose eval estimate` on rendered heaps and piles: as little
# as loses no recall there.

KEPT, WITH_NEAR_SYMMETRIES, SEARCHED = 8, 5, 18
"""Poses that stay after registration; those of them whose near-symmetric rotations are tried; those of both
that are searched."""

JUDGED, FINISHED, ALTERNATIVES = 40, 5, 6
"""Poses judged by all masks; those of them that are searched finely; different poses that are returned."""

COARSE_SAMPLES, SAMPLES = 350, 220
"""Surface samples with which poses are ranked before the search, and in the search."""

SEARCH_DEG, FINE_DEG, PRIOR_DEG = (8.0, 4.0, 2.0, 1.0), (3.0, 1.5, 0.7), (4.0, 2.0, 1.0)
"""Steps of the search, coarse to fine, in degrees: of proposed poses, of the best of them, and of a prior,
which is nearer."""

REGISTERED_WITHIN = 0.5
"""After the search, poses whose total is farther behind the best are not registered again."""

PLAINLY_RIGHT, CLEAR_MARGIN = 1.9, 0.12
"""A refined prior is confirmed, so that views are not searched, if its total is at least PLAINLY_RIGHT and
its near-symmetric rotations are worse by CLEAR_MARGIN. Its margin then counts at most CLEAR_MARGIN.
Chosen."""

CONFIRM_ROTATIONS, CONFIRM_DEG = 3, (3.0, 1.0)
"""Number of near-symmetric rotations of a prior that are searched, all different, and the steps in degrees.
Chosen."""


def answered(
    frame: RgbdFrame,
    query: ObjectQuery,
    model: ReferenceModel,
    segmenter: Segmenter,
    config: EstimatorConfig,
    method: PairMethod | None,
) -> Steps[tuple[PoseEstimate, Explanation]]:
    """The estimate for one query, independent of other queries, and its explanation, in two steps of about
    the same time. method: finds the poses, None for `full`."""
    start = time.perf_counter()
    box, masks = _box_and_masks(frame, query, model, segmenter)
    with stage("evidence"):
        evidence = gather(frame, masks, box, model.diameter_m)
    look, answer = Explanation(box, tuple(masks), evidence), None
    if evidence is not None and query.prior is not None and method is None:
        with stage("prior"):
            prior = refine_prior(model, evidence, query.prior.T_cam_obj)
            if not looks_in_full(frame.frame_id, config.look_anew_every):
                ranked = confirm(model, evidence.region, prior)
                look = replace(look, ranked=ranked, confirmed=len(ranked) > 0)
            look = replace(look, prior=prior)
        if look.confirmed:
            answer = believe(frame, query, model, look, config)
    if answer is None or answer.state != "TRACKING":
        look = replace(look, confirmed=False)
        if method is not None:
            look = replace(look, ranked=_found_by(method, frame, query, model, evidence, config.seed))
        elif evidence is not None:
            with stage("retrieval"):
                crop, bounds = evidence.region.crop, evidence.region.bounds
                views = retrieve(table_of(model), crop, bounds, evidence.sources)
            set_aside = time.perf_counter()
            yield
            start += time.perf_counter() - set_aside
            poses = refine(model, evidence, views.poses, views.masks)
            ranked = judge(model, evidence.region, poses, look.prior)
            with stage("contest"):
                ranked, held = decided(model, evidence.region, ranked)
            look = replace(look, ranked=ranked, contest=held)
        with stage("answer"):
            bare = method is not None and method.bare
            answer = (
                bare_answer(frame, query, model, look) if bare else believe(frame, query, model, look, config)
            )
    return replace(answer, seconds=time.perf_counter() - start), look


def _box_and_masks(
    frame: RgbdFrame, query: ObjectQuery, model: ReferenceModel, segmenter: Segmenter
) -> tuple[Box, list[Bool]]:
    """Box and candidate masks of a query: as given, else the box of the masks or the prior, and the
    segmenter's masks."""
    box, masks = query.box, [np.asarray(m, dtype=bool) for m in query.masks]
    if box is None and masks:
        box = Box.of_mask(np.any(masks, axis=0))
    if box is None and query.prior is not None:
        box = projected_box(model, frame, query.prior.T_cam_obj)
    if box is None:
        if query.prior is None and not masks:
            raise InputError(
                f"query for '{query.object}'",
                found="neither box, masks nor prior",
                expected="at least one of them",
                fix="Ask a detector for a box first.",
            )
        return Box(0.0, 0.0, 0.0, 0.0), masks
    if not masks:
        with stage("masks"):
            masks = segmenter.segment(frame, box, model.diameter_m)
    return box, masks


def check_masks(frame: RgbdFrame, query: ObjectQuery) -> None:
    """Raises InputError if a mask of a query has not the size of the frame."""
    for mask in query.masks:
        if np.shape(mask) != frame.depth.shape:
            raise InputError(
                f"mask of '{query.object}'",
                found=f"{np.shape(mask)}",
                expected=f"{frame.depth.shape}, the size of the frame",
            )


def _found_by(
    method: PairMethod,
    frame: RgbdFrame,
    query: ObjectQuery,
    model: ReferenceModel,
    evidence: Evidence | None,
    seed: int,
) -> Ranked:
    """The poses of a method; its random choices depend on the seed, the object and what the frame shows."""
    method.check(model)
    if evidence is None:
        return NONE
    shown = crc32(np.ascontiguousarray(frame.depth[::8, ::8]).tobytes())
    return method.poses(model, evidence, np.random.default_rng([seed, crc32(query.object.encode()), shown]))


def refine(model: ReferenceModel, evidence: Evidence, proposed: Float64, sources: Int64) -> Float64:
    """Refine proposed poses (N, 4, 4) to poses (M, 4, 4): align each with the source (N,) of the evidence
    that proposed it; add near-symmetric rotations; search on the score; ICP."""
    with stage("icp"):
        aligned = [
            _icp(model, points, proposed[sources == k], 0.1 * model.diameter_m, 0.008, 12)
            for k, points in enumerate(evidence.points_cam)
        ]
    poses, region = np.concatenate(aligned), evidence.region
    if not len(poses):
        return poses
    with stage("turns"):
        totals = score_many(model, region, poses, COARSE_SAMPLES)[:, 0]
        best = different_poses(model, poses, totals, KEPT)
        poses, totals = poses[best], totals[best]
        near_symmetric = model.near_symmetric(poses[:WITH_NEAR_SYMMETRIES])
        near_symmetric_totals = score_many(model, region, near_symmetric, COARSE_SAMPLES)[:, 0]
        poses, totals = (
            np.concatenate([poses, near_symmetric]),
            np.concatenate([totals, near_symmetric_totals]),
        )
        poses = poses[different_poses(model, poses, totals, SEARCHED)]
    with stage("search"):
        searched, totals = search(model, region, poses, SEARCH_DEG, SAMPLES, race=RACE)
    with stage("icp"):
        rivals = searched[totals > totals.max() - REGISTERED_WITHIN]
        registered = _icp(model, region.points_cam, rivals, 0.012, 0.006, 5)
    return np.concatenate([searched, registered])


def refine_prior(model: ReferenceModel, evidence: Evidence, T_cam_obj: Float) -> Ranked:
    """A predicted pose (4, 4), refined: the best of the poses that ICP and search from it give."""
    region = evidence.region
    start = np.asarray(T_cam_obj, dtype=np.float64)[None]
    aligned = [_icp(model, p, start, 0.15 * model.diameter_m, 0.008, 20) for p in evidence.points_cam]
    starts = np.concatenate([start, *aligned])
    searched, _ = search(model, region, starts, PRIOR_DEG, CLOSE_SAMPLES, race=RACE)
    registered = _icp(model, region.points_cam, searched, 0.012, 0.006, 5)
    poses = np.concatenate([starts, searched, registered])
    return Ranked.of(poses, totals_of(model, region, poses)).these([0])


def judge(model: ReferenceModel, region: Region, poses: Float64, prior: Ranked) -> Ranked:
    """Judge refined poses (N, 4, 4), search the best finely, and return different ones, best first. prior:
    the refined prior, judged before, which competes as well."""
    if not len(poses) and not len(prior):
        return NONE
    with stage("judge"):
        totals = np.concatenate([prior.totals, totals_of(model, region, poses)])
        poses = np.concatenate([prior.poses, poses])
        best = different_poses(model, poses, totals, JUDGED, FINAL_TURN_RAD, FINAL_SHIFT)
        poses, totals = poses[best], totals[best]
    with stage("search"):
        fine, fine_totals = search(model, region, poses[:FINISHED], FINE_DEG, CLOSE_SAMPLES, race=RACE)
        poses, totals = np.concatenate([poses, fine]), np.concatenate([totals, fine_totals])
        best = different_poses(model, poses, totals, ALTERNATIVES, FINAL_TURN_RAD, FINAL_SHIFT)
    return Ranked.of(poses[best], totals[best])


def looks_in_full(frame_id: int, every: int) -> bool:
    """Whether this frame is searched in full, whatever its prior: about one frame in `every`, spread
    irregularly, so that no rhythm of requests misses them. Always for 0 and 1."""
    return every <= 1 or (frame_id * 2654435761 >> 16) % every == 0


def confirm(model: ReferenceModel, region: Region, prior: Ranked) -> Ranked:
    """The refined prior first, then its best different near-symmetric rotations; NONE if the prior is not
    clearly right. A search that leads back to the prior, or to an equivalent rotation of it, gives no other
    pose, even if its score is a little better."""
    if prior.totals[0] < PLAINLY_RIGHT:
        return NONE
    alike = prior.poses[0] @ model.equivalents
    rotated = prior.poses[0] @ model.near_symmetries[1:]
    first = score_many(model, region, rotated, COARSE_SAMPLES)[:, 0]
    best = _others(model, alike, rotated, first)[:CONFIRM_ROTATIONS]
    searched, totals = search(model, region, rotated[best], CONFIRM_DEG, CLOSE_SAMPLES, race=RACE)
    others = _others(model, alike, searched, totals)
    found = np.concatenate([prior.poses, searched[others]]), np.append(prior.totals, totals[others])
    ranked, _ = in_their_light(model, region, Ranked.of(*found))
    clear = len(ranked) == 1 or ranked.behind[1] >= CLEAR_MARGIN
    return ranked if clear and np.array_equal(ranked.poses[0], prior.poses[0]) else NONE


def _others(model: ReferenceModel, known: Float64, poses: Float64, totals: Float64) -> Int64:
    """Indices of those poses (N, 4, 4), best total first, that differ from the known ones (K, 4, 4) and from
    all better ones."""
    every, first = np.concatenate([known, poses]), np.append(np.full(len(known), np.inf), totals)
    order = different_poses(model, every, first, len(every), FINAL_TURN_RAD, FINAL_SHIFT)
    return order[order >= len(known)] - len(known)


def _icp(
    model: ReferenceModel, points: Float64, poses: Float64, start_m: float, end_m: float, iterations: int
) -> Float64:
    return align_many(model.surface, model.grid, points, poses, start_m, end_m, iterations)


def believe(
    frame: RgbdFrame,
    query: ObjectQuery,
    model: ReferenceModel,
    look: Explanation,
    config: EstimatorConfig,
) -> PoseEstimate:
    """The estimate for a query: the best of the poses, refined, with its probability and covariance."""
    fit = quality_fits()[config.method]
    least = fit.found if config.found_level is None else config.found_level
    region, ranked, terms = None if look.evidence is None else look.evidence.region, look.ranked, None
    if region is not None and len(ranked):
        ranked = ranked.these(different_answers(model, ranked.poses))
        terms = _terms(model, region, ranked, CLEAR_MARGIN if look.confirmed else None)
    present = 0.0 if terms is None else fit.present(terms)
    answer = _not_found(query, look.prior)
    if region is None or terms is None or present < least:
        total = float(ranked.totals[0]) if len(ranked) else 0.0
        reason = (
            why_unseen(query, look.box, frame.camera) if region is None else why_absent(terms, present, least)
        )
        return replace(answer, score=total, terms=terms, reason=reason)
    chances = fit.probabilities(terms)
    T, alignment, mask = final_refinement(model, frame, region, se3.orthonormalised(ranked.poses[0]))
    # If a prior was only confirmed, one probability may belong to a rival that was not searched and has no
    # pose.
    others = zip(ranked.poses[1:], chances[1:], strict=False)
    return replace(
        answer,
        found=True,
        T_cam_obj=T,
        quality=float(chances[0]),
        state=State.TRACKING if chances[0] >= fit.level else State.SUSPECT,
        score=float(ranked.totals[0]),
        margin=terms.margin,
        covariance=covariance(alignment, model.mesh.centre),
        mask=mask,
        box=projected_box(model, frame, T),
        alternatives=tuple((se3.orthonormalised(other), float(p)) for other, p in others),
        terms=terms,
    )


def bare_answer(
    frame: RgbdFrame, query: ObjectQuery, model: ReferenceModel, look: Explanation
) -> PoseEstimate:
    """The estimate of a method whose best pose is used as it is. Its score is given as quality, which is no
    probability, so its state is never more than SUSPECT. It has no covariance and no terms."""
    answer = _not_found(query)
    if look.evidence is None or not len(look.ranked):
        return answer
    T, total = se3.orthonormalised(look.ranked.poses[0]), float(look.ranked.totals[0])
    mask = visible_mask(model, frame, T, look.evidence.region.tolerance_m)
    box = projected_box(model, frame, T)
    return replace(
        answer, found=True, T_cam_obj=T, quality=total, state=State.SUSPECT, score=total, mask=mask, box=box
    )


def _not_found(query: ObjectQuery, prior: Ranked = NONE) -> PoseEstimate:
    """The estimate for a query for which no pose was found."""
    T, total = (prior.poses[0], float(prior.totals[0])) if len(prior) else (None, None)
    return PoseEstimate(query.object, query.instance, box=query.box, prior_score=total, prior_T_cam_obj=T)


def _terms(model: ReferenceModel, region: Region, ranked: Ranked, largest_gap: float | None) -> QualityTerms:
    """The terms of the first of different poses. largest_gap: if a prior was only confirmed, little else was
    searched; the best other pose then counts as at most this much worse."""
    gaps, T_cam_obj = ranked.behind[1:], ranked.poses[0]
    if largest_gap is not None:
        gaps = np.concatenate([[min([largest_gap, *gaps[:1]])], gaps[1:]])
    dense, seen = score(model, region, T_cam_obj), texture_evidence(model, region, T_cam_obj)
    picture = pair_image(model, region.crop, region.median_depth_m)
    return QualityTerms(
        float(ranked.totals[0]),
        tuple(float(gap) for gap in gaps),
        dense.color,
        dense.box_iou,
        dense.depth_fit,
        dense.coverage,
        dense.violation,
        dense.occluded,
        dense.seen,
        seen.missing,
        seen.foreign,
        seen.detail,
        scale_residual(model, region, T_cam_obj),
        float(np.count_nonzero(region.mask)),
        seen.turned,
        contrast_disagreement(model, region, picture, T_cam_obj),
        float(agreement_many(model, region, picture, T_cam_obj[None])[0]),
    )
