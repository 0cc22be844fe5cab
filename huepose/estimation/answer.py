"""From the poses that were found to the answer: refined on depth and edges, with quality and alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.believe.covariance import covariance
from huepose.believe.quality import QualityFit, QualityTerms
from huepose.estimation.config import ConfirmConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.reasons import why_absent
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.contrast_disagreement import contrast_disagreement_many
from huepose.judge.pair_agreement import agreement_many
from huepose.judge.pair_terms import pair_picture
from huepose.judge.region import Region
from huepose.judge.silhouette import projected_box, visible_mask
from huepose.judge.terms import score as dense_score
from huepose.judge.texture_evidence import texture_evidence
from huepose.model.types import ReferenceModel
from huepose.refine.final import final_refinement
from huepose.refine.scale import scale_residual
from huepose.select.answers import different_answers


@dataclass(frozen=True)
class Levels:
    """acquired: quality from which a pose is TRACKING; found: presence under which nothing is there;
    unrivalled: the margin that a prior counts with which was only confirmed."""

    acquired: float
    found: float
    unrivalled: float = ConfirmConfig().margin


def answer_of(
    frame: RgbdFrame,
    query: ObjectQuery,
    model: ReferenceModel,
    explanation: Explanation,
    fit: QualityFit,
    levels: Levels,
    prior: tuple[Float64, float] | None,
) -> PoseEstimate:
    """The answer to a query. prior: the refined prior (4, 4) and its total, if there was one."""
    prior_T, prior_score = prior if prior is not None else (None, None)
    region = None if explanation.evidence is None else explanation.evidence.region
    poses, totals = explanation.poses, explanation.totals
    terms = None
    if region is not None and len(poses):
        kept = different_answers(model, poses)
        poses, totals = poses[kept], totals[kept]
        terms = _terms(model, region, poses[0], totals, levels.unrivalled if explanation.confirmed else None)
    present = 0.0 if terms is None else fit.present(terms)
    if region is None or terms is None or present < levels.found:
        total = float(totals[0]) if len(totals) else 0.0
        reason = why_absent(explanation, terms, present, levels.found)
        return PoseEstimate(
            query.object, query.instance, False, None, 0.0, "LOST", total, 0.0, None, None,
            query.box, prior_score, prior_T, (), 0.0, terms, reason,
        )  # fmt: skip
    chances = fit.probabilities(terms)
    T, alignment, mask = final_refinement(model, frame, region, se3.orthonormalised(poses[0]))
    others = zip(poses[1:], chances[1 : len(poses)], strict=True)
    return PoseEstimate(
        query.object,
        query.instance,
        True,
        T,
        float(chances[0]),
        "TRACKING" if chances[0] >= levels.acquired else "SUSPECT",
        float(totals[0]),
        terms.margin,
        covariance(alignment),
        mask,
        projected_box(model, frame, T),
        prior_score,
        prior_T,
        tuple((se3.orthonormalised(other), float(p)) for other, p in others),
        0.0,
        terms,
    )


def bare_answer(
    frame: RgbdFrame, query: ObjectQuery, model: ReferenceModel, explanation: Explanation
) -> PoseEstimate:
    """The answer of a method whose best pose stands as it is. Its score is given as quality, which is not a
    probability, so it is never more than SUSPECT; there are no covariance and no terms."""
    if explanation.evidence is None or not len(explanation.poses):
        return PoseEstimate(
            query.object, query.instance, False, None, 0.0, "LOST", 0.0, 0.0, None, None,
            query.box, None, None, (), 0.0,
        )  # fmt: skip
    T, score = se3.orthonormalised(explanation.poses[0]), float(explanation.totals[0])
    mask = visible_mask(model, frame, T, explanation.evidence.region.tolerance_m)
    return PoseEstimate(
        query.object, query.instance, True, T, score, "SUSPECT", score, 0.0, None, mask,
        projected_box(model, frame, T), None, None, (), 0.0,
    )  # fmt: skip


def _terms(
    model: ReferenceModel,
    region: Region,
    T_cam_obj: Float64,
    totals: Float64,
    most_behind: float | None,
) -> QualityTerms:
    """Of the first of different answers. most_behind: where a prior was only confirmed, little else was
    looked at; then the best other answer is taken to be at most so much worse."""
    gaps = totals[0] - totals[1:]
    if most_behind is not None:
        gaps = np.concatenate([[min([most_behind, *gaps[:1]])], gaps[1:]])
    dense, seen = dense_score(model, region, T_cam_obj), texture_evidence(model, region, T_cam_obj)
    contrasts, pose = pair_picture(model, region.crop, region.median_depth_m), T_cam_obj[None]
    return QualityTerms(
        float(totals[0]),
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
        float(contrast_disagreement_many(model, region, contrasts, pose)[0]),
        float(agreement_many(model, region, contrasts, pose)[0]),
    )
