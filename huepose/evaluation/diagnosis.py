"""Why a pose is wrong: where on the way the right one was lost, said in one line from measurements.

The right pose is followed through the steps of the estimator: was it proposed, did registration and search
keep it, and does the judge, on the very pixels that the answer was judged on, prefer it or the answer? What
the judge prefers wrongly is told apart further: by the mask, by a term of the score, or hardly at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from huepose.estimation.explanation import Explanation
from huepose.estimation.reasons import covering, displacement, overlap
from huepose.estimation.types import PoseEstimate
from huepose.evaluation import metrics
from huepose.geometry.arrays import Bool, Float64
from huepose.judge.terms import CLOSE_SAMPLES, DEFAULT_WEIGHTS, Terms, score
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import search

Cause = Literal["no depth", "not proposed", "lost", "settled away", "tie", "mask", "verification"]
"""no depth: nothing to look at; not proposed: no view near the right pose, which would have won; lost: it was
proposed and would have won; settled away: it won, and the last fit to depth spoilt it; tie: the answer scores
hardly more or less than the right pose; mask: it wins because it explains masks that show something else;
verification: it wins by other terms of the score."""

BASIN = 0.35
"""Registration and search lead home from about here (ADD in diameters)."""

HARDLY = 0.05
"""Totals this close are a tie: noise decides."""

WRONG_MASK = 0.5
STEPS_DEG = (3.0, 1.5, 0.7)


@dataclass(frozen=True)
class Diagnosis:
    """cause; line: the diagnosis in words; nearest: ADD in diameters from the right pose to the nearest
    after each step (inf without a pose); answer, truth: scores of the answer and of the right pose, searched
    finely, on the answer's pixels (None without depth); mask_iou: of the best candidate mask with the true
    one, None where that is not known; best: the right pose as it was searched."""

    cause: Cause
    line: str
    nearest: dict[str, float]
    answer: Terms | None
    truth: Terms | None
    mask_iou: float | None
    best: Float64 | None


def diagnose(
    model: ReferenceModel,
    answer: PoseEstimate,
    explanation: Explanation,
    truths: Sequence[Float64],
    mask: Bool | None,
) -> Diagnosis:
    """Why an answer is wrong. truths: poses (4, 4) that count as right; mask (H, W): the true visible one."""
    evidence, trail = explanation.evidence, explanation.trail
    if evidence is None:
        return Diagnosis("no depth", "no depth in the box: nothing to look at", {}, None, None, None, None)
    region = evidence.region
    found, totals = search(model, region, np.stack(truths), STEPS_DEG, CLOSE_SAMPLES)
    best = found[int(np.argmax(totals))]
    truth = score(model, region, best)
    said = score(model, region, explanation.ranked.poses[0]) if len(explanation.ranked) else None
    steps: dict[str, Float64] = {"answers": explanation.ranked.poses}
    if trail is not None:
        steps = {
            "views": trail.retrieved,
            "registered": trail.registered,
            "searched": trail.searched,
            **steps,
        }
    nearest = {name: _nearest(model, poses, truths) for name, poses in steps.items()}
    ious = [overlap(m, mask) for m in explanation.masks] if mask is not None else []
    mask_iou = max(ious, default=0.0) if mask is not None else None
    cause = _cause(model, explanation, truths, said, truth, nearest, mask_iou)
    line = "; ".join(
        part
        for part in (
            _place(model, answer, truths),
            _fate(nearest),
            _judged(cause, said, truth, region.trust),
            _mask(cause, explanation.masks, mask),
        )
        if part
    )
    return Diagnosis(cause, f"{cause}: {line}", nearest, said, truth, mask_iou, best)


def _cause(
    model: ReferenceModel,
    explanation: Explanation,
    truths: Sequence[Float64],
    said: Terms | None,
    truth: Terms,
    nearest: dict[str, float],
    mask_iou: float | None,
) -> Cause:
    if (
        len(explanation.ranked)
        and _nearest(model, explanation.ranked.poses[:1], truths) < metrics.RECALL_FRACTION
    ):
        return "settled away"
    if said is not None and abs(said.total - truth.total) < HARDLY:
        return "tie"
    if said is not None and nearest["answers"] < metrics.RECALL_FRACTION and truth.total > said.total:
        return "verification"  # The close look at near ties preferred the other one.
    if said is None or truth.total > said.total:
        return "not proposed" if nearest.get("views", 0.0) > BASIN else "lost"
    by_mask = _gains(said, truth, explanation.evidence.region.trust)["mask"] if explanation.evidence else 0.0
    wrong = mask_iou is not None and mask_iou < WRONG_MASK
    return "mask" if wrong and said.total - by_mask < truth.total else "verification"


def _place(model: ReferenceModel, answer: PoseEstimate, truths: Sequence[Float64]) -> str:
    """How the answer lies to the nearest right pose."""
    if answer.T_cam_obj is None:
        return "no pose was given"
    T = answer.T_cam_obj
    errors = [metrics.add(model.eval_points, T, truth) for truth in truths]
    return displacement(model, T, truths[int(np.argmin(errors))])


def _fate(nearest: dict[str, float]) -> str:
    """The step after which the right pose was gone."""
    if "views" not in nearest:
        return ""
    limit = metrics.RECALL_FRACTION
    if nearest["answers"] < limit:
        return "the right pose was among the answers"
    if nearest["searched"] < limit:
        return "the right pose was searched and fell behind"
    if nearest["registered"] < limit:
        return "registration had the right pose, the search did not keep it"
    if nearest["views"] > BASIN:
        return f"the nearest view proposed is {nearest['views']:.2f} diameters off"
    return f"a view {nearest['views']:.2f} diameters off was proposed, and was not led home"


def _judged(cause: Cause, said: Terms | None, truth: Terms, trust: float) -> str:
    if said is None:
        return f"the right pose scores {truth.total:.2f}"
    words = f"the right pose scores {truth.total:.2f}, the answer {said.total:.2f}"
    if cause in ("verification", "mask", "tie"):
        gains = sorted(_gains(said, truth, trust).items(), key=lambda item: -item[1])
        words += " (" + ", ".join(f"{name} {gain:+.2f}" for name, gain in gains[:2] if gain > 0.01) + ")"
        if truth.total > said.total + HARDLY:
            words += ", and the close look preferred it all the same"
    return words.replace(" ()", "")


def _gains(said: Terms, truth: Terms, trust: float) -> dict[str, float]:
    """What each term of the score gives the answer over the right pose."""
    w = DEFAULT_WEIGHTS
    return {
        "depth": w.depth_fit * (said.depth_fit - truth.depth_fit),
        "seen through": w.violation * (truth.violation - said.violation),
        "texture": w.color * (said.color - truth.color),
        "mask": w.coverage * trust * (said.coverage - truth.coverage),
        "box": w.box * (said.box_iou - truth.box_iou),
    }


def _mask(cause: Cause, masks: Sequence[Bool], mask: Bool | None) -> str:
    """How the best candidate mask and the true one lie to each other."""
    if mask is None or not masks or not mask.any():
        return ""
    best = max(masks, key=lambda m: overlap(m, mask))
    if cause != "mask" and overlap(best, mask) >= WRONG_MASK:
        return ""
    return covering(best, mask, "the object")


def _nearest(model: ReferenceModel, poses: Float64, truths: Sequence[Float64]) -> float:
    """ADD in diameters of the nearest of poses (N, 4, 4) to the nearest right one."""
    points = model.eval_points[:: max(1, len(model.eval_points) // 500)]
    errors = [metrics.add(points, T, truth) for T in poses for truth in truths]
    return min(errors, default=np.inf) / model.diameter_m
