"""Fitting quality: from estimates with known truth to the probabilities of `huepose.believe.quality`.

Four kinds of estimates are needed. Objects in their own boxes (labels): which of the published answers is
right? Absent objects (others): is the object there? The same shapes with another texture (alike) or in
another size (sizes): is it this object? Figures of a fit are cross-validated: the frames are divided into
folds, and each fold is judged by the fit of the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from huepose.believe.logistic import Logistic
from huepose.believe.quality import QualityFit, QualityTerms, features
from huepose.evaluation.calibration import Judged
from huepose.geometry.arrays import Bool, Float64, Int64
from huepose.support.errors import InputError
from studies.likelihood import choice, logistic


@dataclass(frozen=True)
class Names:
    """The names of the `believe.quality.features` that enter each part of a fit."""

    presence: Sequence[str]
    this_texture: Sequence[str]
    this_size: Sequence[str]
    listed: Sequence[str]
    sharpness: Sequence[str]


FEATURES: Mapping[str, Names] = {
    "full": Names(
        presence=("total", "coverage", "box_iou", "nothing_foreign", "detail", "agreed", "near_size"),
        this_texture=("same_hues", "same_way", "agreed"),
        this_size=("same_size", "box_iou", "no_violation", "detail", "texture_complete"),
        listed=("margin", "total", "box_iou", "detail"),
        sharpness=("detail_seen",),
    ),
    "colorpair": Names(
        presence=("margin", "total", "coverage", "box_iou"),
        this_texture=("total", "same_hues", "same_way", "agreed"),
        this_size=("same_size", "box_iou", "no_violation", "depth_fit"),
        listed=("margin", "total", "box_iou", "depth_fit"),
        sharpness=(),
    ),
}
"""By method: the fewest features whose likelihood on held-out frames is as good as with more."""

ALIKE_WEIGHT, SIZE_WEIGHT = 0.05, 0.2
"""Weight of a look-alike with another texture, and of one in another size. With more weight, objects in dim
light, whose colours fade, count as the first, and half-occluded objects as the second."""

LEVEL_SHARE = 0.99
LOST_SHARE = 0.002
"""Least share of right poses over `level`; share of poses on their objects that may fall under `found`."""

NONE = Judged([], np.zeros(0, np.int64), np.zeros(0, bool), [], [], np.zeros(0), np.zeros(0))

FOLDS = 10
FEWEST = 50
"""Fewer poses than this over a level are not enough to measure 99 %."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A fit, and its cross-validated probabilities: quality of the labels, the others, the look-alikes and
    the other sizes; present_labels, present_others: that the object is there."""

    fit: QualityFit
    labels: Float64
    others: Float64
    alike: Float64
    sizes: Float64
    present_labels: Float64
    present_others: Float64


def fit(
    labels: Judged, names: Names, others: Judged = NONE, alike: Judged = NONE, sizes: Judged = NONE
) -> Fitted:
    """The fit on all data, with cross-validated levels. Without others every object is present, without
    look-alikes every texture is right, without sizes every size. Raises InputError if all or none of the
    labels are right."""
    if labels.right.all() or not labels.right.any():
        raise InputError(
            "calibration",
            found=f"{int(labels.right.sum())} right of {len(labels.which)} poses",
            expected="right ones and wrong ones",
            fix="Use more or harder scenes.",
        )
    parts = (labels, others, alike, sizes)
    folds = [_folds(part) for part in parts]
    quality = [np.zeros(len(part.which)) for part in parts]
    present = [np.ones(len(part.which)) for part in (labels, others)]
    for k in range(FOLDS):
        fitted_on = [part.only(f != k) for part, f in zip(parts, folds, strict=True)]
        held_out = [np.flatnonzero(f == k).tolist() for f in folds]
        if not any(len(h) for h in held_out) or fitted_on[0].right.all() or not fitted_on[0].right.any():
            continue
        of_fold = _fit_once(names, *fitted_on)
        for part, where, q in zip(parts, held_out, quality, strict=True):
            q[where] = [of_fold.probabilities(part.terms[i])[0] for i in where]
        for part, where, p in zip(parts[:2], held_out[:2], present, strict=True):
            p[where] = [of_fold.present(part.terms[i]) for i in where]
    level = level_of(quality[0], labels.right, labels.weights)
    found = float(np.quantile(present[0][labels.placed], LOST_SHARE)) if len(others.which) else 0.0
    whole = replace(_fit_once(names, *parts), level=level, found=found)
    return Fitted(whole, *quality, *present)


def level_of(quality: Float64, right: Bool, weights: Float64, share: float = LEVEL_SHARE) -> float:
    """The lowest quality such that the share `share` of the poses with this quality or more is right; quality
    (N,), right, weights (N,). One wrong pose more than measured is counted, against chance. If there is no
    such quality, or it has fewer than 50 poses: the lowest quality of the 50 best poses."""
    order = np.argsort(-quality, kind="stable")
    each = weights[order]
    true = np.cumsum(each * right[order]) / (np.cumsum(each) + 1.0)
    good = np.flatnonzero(true >= share)
    good = good[good >= min(FEWEST, len(order)) - 1]
    last = int(good[-1]) if len(good) else min(FEWEST, len(order)) - 1
    return float(np.clip(quality[order[last]], 0.01, 0.999))


def as_json(quality_fit: QualityFit) -> dict[str, Any]:
    """The entry of a method in `fits.json`; factors of zero are left out."""
    parts = {name: getattr(quality_fit, name) for name in ("presence", "this_texture", "this_size", "listed")}
    return {
        **{
            name: {"constant": round(part.constant, 4), "factors": _rounded(part.factors)}
            for name, part in parts.items()
        },
        "sharpness": _rounded(quality_fit.sharpness),
        "handicap": round(quality_fit.handicap, 4),
        "level": round(quality_fit.level, 4),
        "found": round(quality_fit.found, 4),
    }


def _fit_once(names: Names, labels: Judged, others: Judged, alike: Judged, sizes: Judged) -> QualityFit:
    right, placed = labels.only(labels.right), labels.only(labels.placed)
    presence = _against(placed, replace(others, weights=np.ones(len(others.which))), names.presence)
    alike = replace(alike, weights=np.full(len(alike.which), ALIKE_WEIGHT))
    sizes = replace(sizes, weights=np.full(len(sizes.which), SIZE_WEIGHT))
    this_texture = _against(right, alike, names.this_texture)
    this_size = _against(right, sizes, names.this_size)
    both = labels + others
    table = _table(both.terms)
    sharpeners = np.stack([np.ones(len(both.which)), *(table[n] for n in names.sharpness)], axis=1)
    known = [features(t) for t in both.terms]
    itself = np.array([this_texture(k) * this_size(k) for k in known])
    columns, gaps = _columns(table, names.listed), _gaps(both.terms)
    sharpeners = np.maximum(sharpeners, 0.0)
    listed, sharpness, handicap = choice(
        columns, gaps, sharpeners, both.which, both.weights, names.listed, itself
    )
    return QualityFit(
        presence=presence,
        this_texture=this_texture,
        this_size=this_size,
        listed=listed,
        sharpness=dict(zip(("constant", *names.sharpness), sharpness.tolist(), strict=True)),
        handicap=handicap,
        level=0.5,
        found=0.0,
    )


def _against(right: Judged, wrong: Judged, names: Sequence[str]) -> Logistic:
    """The logistic function that separates the first from the second; without a second, all belong to the
    first."""
    both = right + wrong
    x = _columns(_table(both.terms), names)
    if not len(wrong.which):
        x = np.zeros_like(x)
    is_right = np.arange(len(both.which)) < len(right.which)
    return logistic(x, is_right, both.weights, names)


def _folds(judged: Judged) -> Int64:
    """The fold (N,) of each pose; all poses of a frame are in one fold."""
    frames = {frame: k for k, frame in enumerate(dict.fromkeys(judged.frames))}
    order = np.random.default_rng(0).permutation(len(frames))
    return np.array([order[frames[frame]] % FOLDS for frame in judged.frames], dtype=np.int64)


def _table(terms: Sequence[QualityTerms]) -> dict[str, Float64]:
    rows = [features(t) for t in terms]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _columns(table: Mapping[str, Float64], names: Sequence[str]) -> Float64:
    return np.stack([table[name] for name in names], axis=1)


def _gaps(terms: Sequence[QualityTerms]) -> Float64:
    """Gaps (N, A): first 0, of the pose itself; inf for no answer."""
    gaps = np.full((len(terms), 1 + max(len(t.gaps) for t in terms)), np.inf)
    for row, t in zip(gaps, terms, strict=True):
        row[: 1 + len(t.gaps)] = [0.0, *(max(gap, 0.0) for gap in t.gaps)]
    return gaps


def _rounded(factors: Mapping[str, float]) -> dict[str, float]:
    return {name: round(f, 4) for name, f in factors.items() if f > 1e-4}
