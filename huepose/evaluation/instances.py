"""The labels of an evaluation, and the assignment of poses to them. An object may have several instances.

An instance of an object is the k-th of its labels in a frame. Poses of tracks are assigned to labels by least
total ADD. The remaining ones are assigned to instances without a label in this frame; the rest are phantoms.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.optimize import linear_sum_assignment

from huepose.datasets.types import GroundTruth, Scene
from huepose.estimation.types import PoseEstimate
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import Float64
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError

_FAR_M = 10.0

ASSIGNMENT_IOU = 0.3
"""Least IoU of boxes at which a pose is assigned to a label."""


@dataclass(frozen=True, eq=False)
class Label:
    """A label. It is evaluated (`counted`), or its poses only do not count as false positives."""

    truth: GroundTruth
    model: ReferenceModel
    T_cam_obj: Float64
    counted: bool


def labels_of(truths: Sequence[GroundTruth], targets: Targets, min_visib: float) -> tuple[list[Label], int]:
    """Labels with a reference model and a pose, and the number of counted labels without a model."""
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
    answers: Sequence[PoseEstimate], labels: Sequence[Label], box_of: Callable[[str, Float64], Box | None]
) -> tuple[dict[int, PoseEstimate], list[tuple[PoseEstimate, Float64]]]:
    """Assign poses to labels of their object, one to one, in order of decreasing quality: each to the free
    label whose projected box it overlaps most, with an IoU of at least 0.3. Returns estimates by index of
    the label, and the remaining poses."""
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
    """Assign poses to counted labels of their object by least total ADD, at any distance. Returns estimates
    by index of the label."""
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


@dataclass(frozen=True, eq=False)
class PublishedPose:
    """What a tracker published for one track in one frame; T_cam_obj (4, 4) and velocity (6,), or None."""

    object: str
    track: int
    T_cam_obj: Float64 | None
    state: str | None
    quality: float
    velocity: Float64 | None = None


@dataclass(frozen=True, eq=False)
class Place:
    """An instance of an object in one frame. ordinal: number of the instance; truth: None if this frame has
    no label of it."""

    model: ReferenceModel
    ordinal: int
    truth: GroundTruth | None


@runtime_checkable
class PartlyLabelled(Protocol):
    """A scene in which some images may have no labels: what these show is unknown."""

    def has_labels(self, image: int) -> bool:
        """Whether an image is labelled, possibly with no object."""
        ...


def has_labels(scene: Scene, image: int) -> bool:
    """Whether an image is labelled: then an object without a label is not in it."""
    return not isinstance(scene, PartlyLabelled) or scene.has_labels(image)


def check_names(scenes: Sequence[Scene]) -> None:
    """Raises InputError for two scenes of the same name: results are listed by name."""
    names = [scene.name for scene in scenes]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"scene '{name}'",
                found="two folders of this name",
                fix="Evaluate them one at a time: results are listed by the folder's name.",
            )


def instance_counts(scene: Scene, images: Iterable[int], targets: Targets) -> dict[str, int]:
    """By model name: the largest number of labels of an object in one of the images. Only objects that have a
    model and are evaluated."""
    counts: dict[str, int] = {}
    for image in images:
        here = Counter(model.name for model, _ in labelled(scene.truths(image), targets))
        counts = {name: max(counts.get(name, 0), here[name]) for name in {*counts, *here}}
    return dict(sorted(counts.items()))


def labelled(truths: Sequence[GroundTruth], targets: Targets) -> list[tuple[ReferenceModel, GroundTruth]]:
    """The labels that have a pose and a model and are evaluated."""
    return [(label.model, label.truth) for label in labels_of(truths, targets, 0.0)[0]]


def places(truths: Sequence[GroundTruth], targets: Targets, counts: Mapping[str, int]) -> list[Place]:
    """All instances of the sequence in one frame, by object and ordinal."""
    by_name: dict[str, list[GroundTruth]] = {}
    for model, truth in labelled(truths, targets):
        by_name.setdefault(model.name, []).append(truth)
    result = []
    for name, count in counts.items():
        model = targets.models_by_name[name]
        here = by_name.get(name, [])
        result += [Place(model, k, here[k] if k < len(here) else None) for k in range(count)]
    return result


def match(
    all_places: Sequence[Place], published: Sequence[PublishedPose]
) -> tuple[list[PublishedPose | None], list[PublishedPose]]:
    """A published pose, or None, for each instance; and the phantoms: poses of no instance."""
    chosen: list[PublishedPose | None] = [None] * len(all_places)
    phantoms: list[PublishedPose] = []
    names = {place.model.name for place in all_places} | {pose.object for pose in published}
    for name in sorted(names):
        indices = [i for i, place in enumerate(all_places) if place.model.name == name]
        tracks = sorted((p for p in published if p.object == name), key=lambda p: p.track)
        with_pose = [p for p in tracks if p.T_cam_obj is not None]
        with_truth = [i for i in indices if all_places[i].truth is not None]
        pairs = _nearest([all_places[i] for i in with_truth], with_pose)
        for label, nearest in pairs:
            chosen[with_truth[label]] = with_pose[nearest]
        used = {id(with_pose[nearest]) for _, nearest in pairs}
        left = sorted((p for p in tracks if id(p) not in used), key=lambda p: p.T_cam_obj is not None)
        free = [i for i in indices if chosen[i] is None]
        # Tracks without a pose go to labelled instances first, remaining poses to instances without a label.
        free.sort(key=lambda i: all_places[i].truth is None)
        for pose in left:
            if not free:
                phantoms += [pose] if pose.T_cam_obj is not None else []
                continue
            chosen[free.pop(0 if pose.T_cam_obj is None else -1)] = pose
    return chosen, phantoms


def _nearest(labels: Sequence[Place], poses: Sequence[PublishedPose]) -> list[tuple[int, int]]:
    """Pairs (label, pose) of least total ADD. Distances are limited to 10 m, so that no outlier dominates."""
    cost = np.full((len(labels), len(poses)), _FAR_M)
    for i, label in enumerate(labels):
        for j, pose in enumerate(poses):
            if label.truth is not None and label.truth.T_cam_obj is not None and pose.T_cam_obj is not None:
                distance = metrics.add(label.model.eval_points, pose.T_cam_obj, label.truth.T_cam_obj)
                cost[i, j] = min(_FAR_M, distance)
    rows, columns = linear_sum_assignment(cost)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))
