"""How good a detector is on labelled pictures: average precision at an overlap of one half."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.perception.letterbox import suppress_overlaps
from huepose.perception.yolo_layouts import Candidates

SAME = 0.5
OVERLAP = 0.45
CONFIDENCE = 0.25
"""As the detector's own default: recall and false boxes are counted there."""


@dataclass(frozen=True)
class DetectorScore:
    """precision: average precision at IoU 0.5, mean over classes; recall, and false boxes in a picture, of
    boxes over the default confidence."""

    precision: float
    recall: float
    false_boxes: float


def score(
    found: Sequence[Candidates], corners: Sequence[Float], classes: Sequence[np.ndarray], count: int
) -> DetectorScore:
    """Of what was found in pictures, before overlapping boxes are dropped, against their labels: corners
    (K, 4) and classes (K,) by picture; count: of classes."""
    rows: list[tuple[int, float, bool]] = []
    for one, boxes, labels in zip(found, corners, classes, strict=True):
        kept = suppress_overlaps(one.corners, one.scores, one.classes, OVERLAP)
        rows += _judged(one, kept, np.asarray(boxes, np.float64), labels)
    label = np.array([r[0] for r in rows], int)
    value = np.array([r[1] for r in rows])
    right = np.array([r[2] for r in rows], bool)
    wanted = np.bincount(np.concatenate([np.asarray(c, int) for c in classes]), minlength=count)
    order = np.argsort(-value, kind="stable")
    parts = [
        average_precision(right[order][label[order] == k], int(wanted[k])) for k in range(count) if wanted[k]
    ]
    sure = value > CONFIDENCE
    return DetectorScore(
        float(np.mean(parts)) if parts else 0.0,
        float(right[sure].sum() / max(wanted.sum(), 1)),
        float((~right[sure]).sum() / max(len(found), 1)),
    )


def average_precision(right: np.ndarray, wanted: int) -> float:
    """Area under precision against recall of answers in the order of their score, precision made falling.

    >>> average_precision(np.array([True, False, True]), 2)
    0.8333333333333333
    """
    if not len(right):
        return 0.0
    hits = np.cumsum(right)
    precision = hits / np.arange(1, len(right) + 1)
    falling = np.maximum.accumulate(precision[::-1])[::-1]
    return float(falling[right].sum() / wanted)


def _judged(
    one: Candidates, kept: np.ndarray, boxes: Float64, labels: np.ndarray
) -> list[tuple[int, float, bool]]:
    """(class, score, whether it is a label's, each of which counts once) of the kept boxes, best first."""
    left = np.ones(len(boxes), bool)
    out = []
    for i in kept:
        same = left & (labels == one.classes[i])
        iou = np.where(same, _iou(one.corners[i], boxes), 0.0)
        hit = bool(len(iou)) and iou.max() >= SAME
        if hit:
            left[int(iou.argmax())] = False
        out.append((int(one.classes[i]), float(one.scores[i]), hit))
    return out


def _iou(box: Float64, boxes: Float64) -> Float64:
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=1)
    areas = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    return np.asarray(common / np.maximum(np.prod(box[2:] - box[:2]) + areas - common, 1e-9))
