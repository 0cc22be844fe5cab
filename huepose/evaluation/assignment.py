"""Labels that an evaluation is about, and which pose counts for which of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from huepose.datasets.types import GroundTruth
from huepose.estimation.types import PoseEstimate
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel

ASSIGNMENT_IOU = 0.3
"""Least overlap of boxes at which a pose is of a label."""


@dataclass(frozen=True, eq=False)
class Label:
    """A label that is evaluated (`counted`), or that only takes its poses away from the false ones."""

    truth: GroundTruth
    model: ReferenceModel
    T_cam_obj: Float64
    counted: bool


def labels_of(truths: Sequence[GroundTruth], targets: Targets, min_visib: float) -> tuple[list[Label], int]:
    """Labels that have a model and a pose, and the number of wanted ones that have no model."""
    labels, without_model = [], 0
    for truth in truths:
        if not targets.wants(truth) or truth.T_cam_obj is None:
            continue
        counted = truth.shows(min_visib)
        model = targets.model_of(truth)
        if model is not None:
            labels.append(Label(truth, model, truth.T_cam_obj, counted))
        elif counted:
            without_model += 1
    return labels, without_model


def assigned(
    answers: Sequence[PoseEstimate],
    labels: Sequence[Label],
    box_of: Callable[[str, Float64], Box | None],
) -> tuple[dict[int, PoseEstimate], list[tuple[PoseEstimate, Float64]]]:
    """Poses to labels of their object, one to one, the surest pose first, each to the label whose projected
    box it overlaps most, by IoU 0.3 at least. Returns answers by index of the label, and the spare poses."""
    taken: dict[int, PoseEstimate] = {}
    spare = []
    boxes = [box_of(label.model.name, label.T_cam_obj) for label in labels]
    for answer, T_cam_obj in sorted(_found(answers), key=lambda item: -item[0].quality):
        box = box_of(answer.object, T_cam_obj)
        overlaps = [
            box.iou(other)
            if box is not None and other is not None and i not in taken and label.model.name == answer.object
            else 0.0
            for i, (label, other) in enumerate(zip(labels, boxes, strict=True))
        ]
        best = int(np.argmax(overlaps)) if overlaps else 0
        if overlaps and overlaps[best] >= ASSIGNMENT_IOU:
            taken[best] = answer
        else:
            spare.append((answer, T_cam_obj))
    return taken, spare


def localised(answers: Sequence[PoseEstimate], labels: Sequence[Label]) -> dict[int, PoseEstimate]:
    """Poses to labels that count, of their object, by least total ADD, wherever they lie: by index of the
    label."""
    taken: dict[int, PoseEstimate] = {}
    for name in {label.model.name for label in labels if label.counted}:
        mine = [(i, x) for i, x in enumerate(labels) if x.counted and x.model.name == name]
        own = [(answer, T) for answer, T in _found(answers) if answer.object == name]
        cost = [[metrics.add(x.model.eval_points, T, x.T_cam_obj) for _, T in own] for _, x in mine]
        for row, column in zip(*linear_sum_assignment(np.reshape(cost, (len(mine), len(own)))), strict=True):
            taken[mine[row][0]] = own[column][0]
    return taken


def _found(answers: Sequence[PoseEstimate]) -> Iterator[tuple[PoseEstimate, Float64]]:
    for answer in answers:
        if answer.found and answer.T_cam_obj is not None:
            yield answer, answer.T_cam_obj
