"""Single-frame accuracy: the estimator on all labelled frames, in disturbed true boxes or a detector's."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np

from huepose.datasets.bop_detections import BopDetections
from huepose.datasets.boxes import Disturbance, disturbed, projected_box, truth_box
from huepose.datasets.types import Sample, Scene
from huepose.estimation.accepted import accepted_answers, why_none_accepted
from huepose.estimation.types import ObjectQuery, PoseEstimate, PosePrior
from huepose.evaluation.bop_errors import BopErrors, BopObject, BopScore, bop_errors, matched_recalls
from huepose.evaluation.estimate_rows import EstimateResult, EstimateRow, FalsePose
from huepose.evaluation.instances import Label, assigned, check_names, has_labels, labels_of, localised
from huepose.evaluation.targets import Key, Targets, object_number
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.perception.types import Detector
from huepose.support.errors import InputError
from huepose.support.progress import progress


class PoseEstimator(Protocol):
    """An estimator to evaluate."""

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """One estimate for each query."""
        ...


@dataclass(frozen=True)
class EstimateOptions:
    """boxes: `detect` runs a detector for all objects in every image; `file` takes the boxes of the highest
    score from a file, as many as an object has labels; masks: `gt` gives the true visible mask.

    Labels that are less visible than `min_visib` are left out; those of unknown visibility are kept."""

    boxes: Disturbance | Literal["detect", "file"] = "perturbed"
    masks: Literal["auto", "gt"] = "auto"
    min_visib: float = 0.0
    seeds: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if self.boxes in ("detect", "file") and self.masks == "gt":
            raise InputError(
                f"--boxes {self.boxes} with --masks gt",
                found="true masks for boxes that belong to no label",
                fix="Use --masks auto.",
            )


@dataclass(frozen=True, eq=False)
class EstimateSetup:
    """What is evaluated, and how.

    equivalents: transforms of labels to poses that count as right, too; detector: for boxes `detect`;
    bop_objects: by BOP id, the objects for which BOP's errors are computed; given: the boxes for `file`."""

    targets: Targets
    estimator: PoseEstimator
    options: EstimateOptions
    equivalents: Mapping[Key, Sequence[Float64]] = field(default_factory=dict)
    detector: Detector | None = None
    bop_objects: Mapping[int, BopObject] = field(default_factory=dict)
    given: BopDetections | None = None

    def __post_init__(self) -> None:
        if self.options.boxes == "detect" and self.detector is None:
            raise InputError("--boxes detect", found="no detector", fix="Give one, or use --boxes perturbed.")

    def image(self, scene: Scene, image: int) -> ImageAnswers:
        """Run the estimator on one image with every seed. Raises InputError for a broken file."""
        truths = scene.truths(image)
        labels, without_model = labels_of(truths, self.targets, self.options.min_visib)
        rows: list[EstimateRow] = []
        false: list[FalsePose] = []
        sample = None
        if labels or (self.options.boxes == "detect" and has_labels(scene, image)):
            sample = Sample(scene.frame(image), truths, scene.name, image)
            for seed in self.options.seeds:
                run = _FrameRun(sample, labels, self, seed)
                new, wrong = run.answers()
                rows += new
                false += wrong
        return ImageAnswers(rows, false, without_model, sample)


@dataclass(frozen=True, eq=False)
class ImageAnswers:
    """The result of one image: rows of all seeds; false: poses of no label; without_model: number of labels
    without a reference model; sample: the image, None if it was not evaluated."""

    rows: list[EstimateRow]
    false: list[FalsePose]
    without_model: int
    sample: Sample | None


def evaluate_estimates(
    scenes: Sequence[Scene],
    targets: Targets,
    estimator: PoseEstimator,
    options: EstimateOptions,
    *,
    on_frame: Callable[[Sample, list[EstimateRow]], None] | None = None,
    **more: Any,
) -> EstimateResult:
    """Run the estimator on all labelled images of the scenes. `on_frame` is called with each frame and its
    rows; `more`: the other fields of EstimateSetup.

    Raises InputError if nothing is labelled, `boxes` is `detect` without a detector, or two scenes have the
    same name."""
    check_names(scenes)
    setup = EstimateSetup(targets, estimator, options, **more)
    rows: list[EstimateRow] = []
    false: list[FalsePose] = []
    skipped = frames = 0
    images = [(scene, image) for scene in scenes for image in scene.image_ids]
    for scene, image in progress(images, "frames"):
        answers = setup.image(scene, image)
        rows += answers.rows
        false += answers.false
        skipped += answers.without_model
        frames += answers.sample is not None
        if on_frame is not None and answers.sample is not None:
            for seed in options.seeds:
                on_frame(answers.sample, [row for row in answers.rows if row.seed == seed])
    if not rows:
        raise InputError(
            "scenes " + ", ".join(scene.name for scene in scenes),
            found=f"no label of an onboarded object ({skipped} of other objects)",
            expected="labels in scene_gt.json of objects that have a reference model",
            fix="Onboard the objects, or check --objects, --bundles and --min-visib.",
        )
    rows.sort(key=lambda r: options.seeds.index(r.seed))
    return EstimateResult(rows, false, skipped, options.boxes, options.masks, options.seeds, frames)


@dataclass(frozen=True, eq=False)
class _FrameRun:
    """One frame with one seed."""

    sample: Sample
    labels: Sequence[Label]
    setup: EstimateSetup
    seed: int

    def answers(self) -> tuple[list[EstimateRow], list[FalsePose]]:
        """A row for each label that counts, and the poses of no label."""
        setup = self.setup
        if setup.detector is not None and setup.options.boxes == "detect":
            return self.detected(setup.detector)
        if setup.given is not None and setup.options.boxes == "file":
            return self.given(setup.given), []
        return self.boxed(), []

    def boxed(self) -> list[EstimateRow]:
        """One query for each label."""
        queries: dict[int, ObjectQuery] = {}
        for label in self.labels:
            query = self._query(label) if label.counted else None
            if query is not None:
                queries[label.truth.instance] = query
        start = time.perf_counter()
        answers = self._estimated(queries)
        seconds = time.perf_counter() - start
        by_instance = {answer.instance: answer for answer in answers}
        taken = {
            i: by_instance[label.truth.instance]
            for i, label in enumerate(self.labels)
            if label.counted and label.truth.instance in by_instance
        }
        why = "The box is empty: nothing of the object is in the image."
        return self._rows(queries, taken, seconds, lambda name: why)

    def _estimated(self, queries: Mapping[int, ObjectQuery]) -> list[PoseEstimate]:
        answers = self.setup.estimator.estimate(self.sample.frame, list(queries.values())) if queries else []
        return [_finite(answer) for answer in answers]

    def _query(self, label: Label) -> ObjectQuery | None:
        """The query of a label; None if its true mask or box is empty: nothing of the object is in the
        image."""
        camera, truth = self.sample.frame.camera, label.truth
        masks: tuple[Bool, ...] = ()
        if self.setup.options.masks == "gt":
            mask = truth.mask()
            if mask is None:
                raise InputError(
                    f"scene {self.sample.scene}, image {self.sample.image}, instance {truth.instance}",
                    found="no visible mask",
                    expected="mask_visib/IMAGE_INSTANCE.png for --masks gt",
                    fix="Use --masks auto.",
                )
            if not mask.any():
                return None
            masks = (mask,)
        boxes = self.setup.options.boxes
        kind: Disturbance = "gt" if boxes == "detect" or boxes == "file" else boxes
        true_box = truth_box(truth, label.model.mesh, camera)
        if true_box is None:
            return None
        where = (self.sample.scene, self.sample.image, truth.instance)
        box = disturbed(true_box, kind, self.seed, *where, camera)
        if box.area == 0:
            return None
        return ObjectQuery(label.model.name, box=box, masks=masks, instance=truth.instance)

    def detected(self, detector: Detector) -> tuple[list[EstimateRow], list[FalsePose]]:
        """Search for every object. The poses that are kept are matched to the labels of their object."""
        start = time.perf_counter()
        names = [model.name for model in self.setup.targets.models]
        detections = detector.detect(self.sample.frame, names)
        queries = {
            i: ObjectQuery(d.object, box=d.box, instance=i, searched=True) for i, d in enumerate(detections)
        }
        answers = self._estimated(queries)
        poses = accepted_answers(answers)

        def why(name: str) -> str:
            if any(pose.object == name for pose in poses):
                return "The poses of the object that are kept are at other positions."
            return why_none_accepted(name, answers)

        taken, spare = assigned(poses, self.labels, self._box_of)
        rows = self._rows(queries, taken, time.perf_counter() - start, why)
        return rows, [self._false(answer, T) for answer, T in spare]

    def given(self, boxes: BopDetections) -> list[EstimateRow]:
        """BOP's localisation task: the objects and the number of their instances are known; the boxes of the
        highest score are used for each object."""
        start = time.perf_counter()
        due = Counter(label.model.name for label in self.labels if label.counted)
        queries: dict[int, ObjectQuery] = {}
        for box in boxes.of(self.sample.scene, self.sample.image):
            model = self.setup.targets.named(box.object_id)
            if model is not None and due[model.name] > 0:
                due[model.name] -= 1
                prior = None if box.T_cam_obj is None else PosePrior(box.T_cam_obj)
                k = len(queries)
                queries[k] = ObjectQuery(model.name, box.box, prior=prior, instance=k)
        answers = self._estimated(queries)
        reasons = {answer.object: answer.reason for answer in answers}

        def why(name: str) -> str:
            if name not in reasons:
                return "The file has no box of the object in this image."
            return reasons[name] or "The pose of the object is at another position."

        taken = localised(answers, self.labels)
        return self._rows(queries, taken, time.perf_counter() - start, why)

    def _rows(
        self,
        queries: Mapping[int, ObjectQuery],
        taken: Mapping[int, PoseEstimate],
        seconds: float,
        why: Callable[[str], str],
    ) -> list[EstimateRow]:
        """A row for each label that counts. queries: by instance; taken: estimates by index of the label;
        why: the reason for a label without an estimate, by the object's name."""
        scores, rows = self._bop_scores(taken), []
        for i, label in enumerate(self.labels):
            if label.counted:
                name = label.model.name
                answer = taken.get(i) or PoseEstimate(name, instance=-1, reason=why(name))
                query = queries.get(answer.instance)
                box = None if query is None else query.box
                rows.append(self._row(label, answer, box, seconds, scores.get(i)))
        return rows

    def _box_of(self, name: str, T_cam_obj: Float64) -> Box | None:
        model = self.setup.targets.models_by_name[name]
        return projected_box(model.mesh, T_cam_obj, self.sample.frame.camera)

    def _bop_scores(self, answers: Mapping[int, PoseEstimate]) -> dict[int, BopScore]:
        """BOP's scores by index of the label, for the objects with BOP's errors. answers: by index of the
        label."""
        groups: dict[int, list[int]] = {}
        for i, label in enumerate(self.labels):
            number = label.model.object_id
            if label.counted and number is not None and number in self.setup.bop_objects:
                groups.setdefault(number, []).append(i)
        frame = self.sample.frame
        scores: dict[int, BopScore] = {}
        for number, labels in groups.items():
            found = [i for i in labels if i in answers and answers[i].found]
            found.sort(key=lambda i: (answers[i].quality, answers[i].score), reverse=True)
            errors = {
                i: [
                    bop_errors(
                        self.setup.bop_objects[number],
                        answers[i].T_cam_obj,
                        self.labels[k].T_cam_obj,
                        frame.depth,
                        frame.camera,
                    )
                    for k in labels
                ]
                for i in found
            }
            missing = [BopErrors.missing()] * len(labels)
            recalls = matched_recalls([*errors.values(), missing])
            for place, (i, share) in enumerate(zip(labels, recalls, strict=True)):
                scores[i] = BopScore(errors.get(i, missing)[place], share)
        return scores

    def _false(self, answer: PoseEstimate, T_cam_obj: Float64) -> FalsePose:
        return FalsePose(
            self.sample.scene,
            self.sample.image,
            object_number(self.setup.targets.models_by_name[answer.object]),
            T_cam_obj,
            answer.quality,
            answer.state,
            self.seed,
            answer.terms,
        )

    def _row(
        self,
        label: Label,
        answer: PoseEstimate,
        box: Box | None,
        seconds: float,
        bop: BopScore | None,
    ) -> EstimateRow:
        T_cam_obj, others = (answer.T_cam_obj, answer.alternatives) if answer.found else (None, ())
        truth = label.truth
        key = (self.sample.scene, self.sample.image, truth.instance)
        equivalents = self.setup.equivalents.get(key, ())
        error = self.setup.targets.error(label.model, T_cam_obj, label.T_cam_obj, equivalents)
        return EstimateRow(
            scene=self.sample.scene,
            image=self.sample.image,
            instance=truth.instance,
            object=object_number(label.model),
            visib_fract=truth.visib_fract,
            T_cam_obj=None if T_cam_obj is None else np.asarray(T_cam_obj, dtype=np.float64),
            error=error,
            diameter_m=label.model.diameter_m,
            quality=answer.quality,
            state=answer.state,
            seconds=seconds,
            seed=self.seed,
            reason=answer.reason,
            box=box,
            terms=answer.terms,
            bop=bop,
            alternatives=tuple(
                (p, self.setup.targets.right(label.model, T, label.T_cam_obj, equivalents)) for T, p in others
            ),
        )


def _finite(answer: PoseEstimate) -> PoseEstimate:
    """The answer, without its pose if that is not finite."""
    if answer.T_cam_obj is None or np.isfinite(answer.T_cam_obj).all():
        return answer
    reason = "The estimator gave a pose that is not finite."
    return PoseEstimate(answer.object, answer.instance, seconds=answer.seconds, reason=reason)
