"""Perception in whole frames: the boxes that the detector proposes, the poses that the estimator keeps, and
the quality of masks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.datasets.boxes import disturbed, truth_box
from huepose.datasets.types import GroundTruth, Sample, Scene
from huepose.estimation.accepted import accepted_answers
from huepose.estimation.reasons import overlap
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.evaluation.estimate_protocol import PoseEstimator
from huepose.evaluation.instances import check_names, has_labels
from huepose.evaluation.perception_rows import FalseBox, FrameFigures, PerceptionResult, PerceptionRow
from huepose.evaluation.targets import Targets, object_number
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel
from huepose.perception.types import Detection, Detector, Segmenter
from huepose.support.errors import InputError
from huepose.support.progress import progress

SAME = 0.5
"""Least IoU at which a box belongs to a label of its object."""


@dataclass(frozen=True)
class PerceptionOptions:
    """judged: largest number of proposals of one object that are estimated; least: least score of an
    estimated proposal; seed: of the disturbed boxes. Labels that are hardly visible are not counted, and
    boxes on them are no false positives."""

    judged: int = 2
    least: float = 0.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class _Label:
    truth: GroundTruth
    model: ReferenceModel
    box: Box


def evaluate_perception(
    scenes: Sequence[Scene],
    targets: Targets,
    detector: Detector,
    segmenter: Segmenter,
    estimator: PoseEstimator,
    options: PerceptionOptions,
    *,
    on_frame: Callable[[Sample, FrameFigures], None] | None = None,
) -> PerceptionResult:
    """Search for all objects of `targets` in all labelled images, whether these show them or not.
    `on_frame` is called with each frame and its figures.

    Raises InputError if nothing is labelled, or two scenes have the same name."""
    check_names(scenes)
    frames = []
    names = [model.name for model in targets.models]
    images = [(scene, image) for scene in scenes for image in scene.image_ids if has_labels(scene, image)]
    for scene, image in progress(images, "frames"):
        sample = Sample.of(scene, image)
        run = _FrameRun(sample, _labels(sample, targets), targets, detector, segmenter, estimator, options)
        figures = run.figures(names)
        frames.append(figures)
        if on_frame is not None:
            on_frame(sample, figures)
    if not any(frame.rows for frame in frames):
        raise InputError(
            "scenes " + ", ".join(scene.name for scene in scenes),
            found="no label of an onboarded object",
            expected="labels in scene_gt.json of objects that have a reference model",
            fix="Onboard the objects, or check --objects and --bundles.",
        )
    return PerceptionResult(frames, len(names))


def _labels(sample: Sample, targets: Targets) -> list[_Label]:
    labels = []
    for truth in sample.truths:
        model = targets.model_of(truth)
        if model is None or not targets.wants(truth):
            continue
        box = truth_box(truth, model.mesh, sample.frame.camera)
        if box is not None:
            labels.append(_Label(truth, model, box))
    return labels


@dataclass(frozen=True, eq=False)
class _FrameRun:
    """The evaluation of one frame."""

    sample: Sample
    labels: Sequence[_Label]
    targets: Targets
    detector: Detector
    segmenter: Segmenter
    estimator: PoseEstimator
    options: PerceptionOptions

    def figures(self, names: Sequence[str]) -> FrameFigures:
        """Search for the objects of these names, and segment all labelled objects."""
        sample, options = self.sample, self.options
        start = time.perf_counter()
        detections = self.detector.detect(sample.frame, names)
        found_s = time.perf_counter() - start
        judged = first_of_each([d for d in detections if d.score >= options.least], options.judged)
        queries = [ObjectQuery(d.object, box=d.box, instance=i, searched=True) for i, d in enumerate(judged)]
        answers = self.estimator.estimate(sample.frame, queries) if queries else []
        seconds = time.perf_counter() - start
        taken, false = self._assigned(accepted_answers(answers))
        rows = [
            self._row(
                label,
                [d for d in detections if d.object == label.model.name],
                taken.get(label.truth.instance),
            )
            for label in self.labels
            if label.truth.visible
        ]
        return FrameFigures(sample.scene, sample.image, rows, false, found_s, seconds)

    def _row(self, label: _Label, proposals: Sequence[Detection], pose: PoseEstimate | None) -> PerceptionRow:
        rank = next((k for k, d in enumerate(proposals, 1) if d.box.iou(label.box) >= SAME), None)
        mask_iou, final_iou = self._mask_ious(label)
        return PerceptionRow(
            self.sample.scene,
            self.sample.image,
            label.truth.instance,
            object_number(label.model),
            label.model.name,
            label.truth.visib_fract,
            label.box,
            rank,
            max((d.box.iou(label.box) for d in proposals), default=0.0),
            mask_iou,
            final_iou,
            None if pose is None else pose.quality,
        )

    def _mask_ious(self, label: _Label) -> tuple[float | None, float | None]:
        """IoU with the visible mask of the segmenter's first mask, and of the estimator's final mask, in a
        disturbed box."""
        sample, true_mask = self.sample, label.truth.mask()
        if true_mask is None or not true_mask.any():
            return None, None
        where = (sample.scene, sample.image, label.truth.instance)
        box = disturbed(label.box, "perturbed", self.options.seed, *where, sample.frame.camera)
        if box.area == 0:
            return None, None
        mask = self.segmenter.segment(sample.frame, box, label.model.diameter_m)[0]
        answer = self.estimator.estimate(sample.frame, [ObjectQuery(label.model.name, box=box)])[0]
        final = np.zeros_like(true_mask) if answer.mask is None else answer.mask
        return overlap(mask, true_mask), overlap(final, true_mask)

    def _assigned(self, poses: Sequence[PoseEstimate]) -> tuple[dict[int, PoseEstimate], list[FalseBox]]:
        """Kept poses by the instance that they find, and false positives. The box of a pose is that of the
        pixels that it explains."""
        taken: dict[int, PoseEstimate] = {}
        false = []
        for pose in poses:
            box = None if pose.mask is None else Box.of_mask(pose.mask)
            if box is None:
                continue
            mine = [x for x in self.labels if x.model.name == pose.object and x.truth.instance not in taken]
            best = max(mine, key=lambda x: x.box.iou(box), default=None)
            if best is not None and best.box.iou(box) >= SAME:
                taken[best.truth.instance] = pose
            elif best is None or best.truth.visible or best.box.iou(box) == 0.0:
                model = self.targets.models_by_name[pose.object]
                where = (self.sample.scene, self.sample.image, object_number(model), model.name)
                false.append(FalseBox(*where, box, pose.quality, _shown(self.labels, box)))
        return taken, false


def first_of_each(detections: Sequence[Detection], most: int) -> list[Detection]:
    """The first detections of each object, at most `most`."""
    counts: dict[str, int] = {}
    chosen = []
    for d in detections:
        counts[d.object] = counts.get(d.object, 0) + 1
        if counts[d.object] <= most:
            chosen.append(d)
    return chosen


def _shown(labels: Sequence[_Label], box: Box) -> str | None:
    """The labelled object that a box overlaps most; None if the IoU is under a third."""
    best = max(labels, key=lambda x: x.box.iou(box), default=None)
    return best.model.name if best is not None and best.box.iou(box) >= 1 / 3 else None
