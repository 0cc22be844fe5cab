"""From the poses that were found to the answer: refined on depth and edges, with quality and alternatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from huepose.believe.quality import QualityFit, QualityTerms
from huepose.estimation.config import ConfirmConfig
from huepose.estimation.explanation import Explanation
from huepose.estimation.reasons import why_absent
from huepose.estimation.types import ObjectQuery, PoseEstimate, absent
from huepose.geometry import se3
from huepose.geometry.frame import RgbdFrame
from huepose.judge.pairs import pair_picture
from huepose.judge.region import Region
from huepose.judge.silhouette import projected_box, visible_mask
from huepose.judge.terms import score as dense_score
from huepose.judge.texture_evidence import agreement_many, contrast_disagreement_many, texture_evidence
from huepose.model.types import ReferenceModel
from huepose.refine.final import covariance, final_refinement, scale_residual
from huepose.select.distinct import NONE, Ranked, different_answers


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
    look: Explanation,
    fit: QualityFit,
    levels: Levels,
) -> PoseEstimate:
    """The answer to a query."""
    region, ranked, terms = None if look.evidence is None else look.evidence.region, look.ranked, None
    if region is not None and len(ranked):
        ranked = ranked.these(different_answers(model, ranked.poses))
        terms = _terms(model, region, ranked, levels.unrivalled if look.confirmed else None)
    present = 0.0 if terms is None else fit.present(terms)
    answer = _of_none(query, look.prior)
    if region is None or terms is None or present < levels.found:
        score = float(ranked.totals[0]) if len(ranked) else 0.0
        reason = why_absent(look, terms, present, levels.found)
        return replace(answer, score=score, terms=terms, reason=reason)
    chances = fit.probabilities(terms)
    T, alignment, mask = final_refinement(model, frame, region, se3.orthonormalised(ranked.poses[0]))
    # A prior that was only confirmed has a chance for a rival that nobody looked for: it has no pose.
    others = zip(ranked.poses[1:], chances[1:], strict=False)
    return replace(
        answer,
        found=True,
        T_cam_obj=T,
        quality=float(chances[0]),
        state="TRACKING" if chances[0] >= levels.acquired else "SUSPECT",
        score=float(ranked.totals[0]),
        margin=terms.margin,
        covariance=covariance(alignment),
        mask=mask,
        box=projected_box(model, frame, T),
        alternatives=tuple((se3.orthonormalised(other), float(p)) for other, p in others),
        terms=terms,
    )


def bare_answer(
    frame: RgbdFrame, query: ObjectQuery, model: ReferenceModel, look: Explanation
) -> PoseEstimate:
    """The answer of a method whose best pose stands as it is. Its score is given as quality, which is not a
    probability, so it is never more than SUSPECT; there are no covariance and no terms."""
    answer = _of_none(query)
    if look.evidence is None or not len(look.ranked):
        return answer
    T, score = se3.orthonormalised(look.ranked.poses[0]), float(look.ranked.totals[0])
    mask = visible_mask(model, frame, T, look.evidence.region.tolerance_m)
    box = projected_box(model, frame, T)
    return replace(
        answer, found=True, T_cam_obj=T, quality=score, state="SUSPECT", score=score, mask=mask, box=box
    )


def _of_none(query: ObjectQuery, prior: Ranked = NONE) -> PoseEstimate:
    """The answer to a query for which nothing was found."""
    T, score = (prior.poses[0], float(prior.totals[0])) if len(prior) else (None, None)
    return replace(
        absent(query.object),
        instance=query.instance,
        box=query.box,
        prior_score=score,
        prior_T_cam_obj=T,
    )


def _terms(model: ReferenceModel, region: Region, ranked: Ranked, most_behind: float | None) -> QualityTerms:
    """Of the first of different answers. most_behind: where a prior was only confirmed, little else was
    looked at; then the best other answer is taken to be at most so much worse."""
    gaps, T_cam_obj = ranked.behind[1:], ranked.poses[0]
    if most_behind is not None:
        gaps = np.concatenate([[min([most_behind, *gaps[:1]])], gaps[1:]])
    dense, seen = dense_score(model, region, T_cam_obj), texture_evidence(model, region, T_cam_obj)
    contrasts, pose = pair_picture(model, region.crop, region.median_depth_m), T_cam_obj[None]
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
        float(contrast_disagreement_many(model, region, contrasts, pose)[0]),
        float(agreement_many(model, region, contrasts, pose)[0]),
    )
