"""Tracking accuracy: a tracker is started once (`free`), or gets late results as in ROFT's evaluation
(`roft`).

ROFT (Piga et al. 2022) simulates perception at 5 Hz whose results are one period late
(DatasetImageSegmentationDelayed.cpp: at 30 Hz the result of frame i - 6 at every sixth frame). Here the same
rule is applied to timestamps, so that it holds for skipped frames and irregular timestamps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, Protocol

from huepose.datasets.types import Sample, Scene
from huepose.estimation.types import PosePrior
from huepose.evaluation.instances import (
    Place,
    PublishedPose,
    check_names,
    has_labels,
    instance_counts,
    places,
)
from huepose.evaluation.sources import FileSource, PoseSource, SourcedPose
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_rows import TrackResult, TrackRow, rows_of_frame
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.support.errors import InputError
from huepose.support.progress import progress
from huepose.tracking.types import Applied, Correction, TrackedPose, Verdict

PERIOD_NS = 200_000_000
"""Time between two requests, and from the frame of a request to its result."""

_TOLERANCE_NS = 1_000_000
"""By which a frame may be early: timestamps are rounded, and six frames at 30 Hz are exactly one period."""


class Delivery(NamedTuple):
    """A late result: of the fed frame `looked_at`, delivered with the fed frame `delivered` (None: after the
    last one)."""

    looked_at: int
    delivered: int | None


def fed_images(image_ids: Sequence[int], every: int) -> tuple[int, ...]:
    """The images i with (i - first) mod `every` == 0. Raises InputError if `every` is less than 1.

    >>> fed_images([3, 4, 5, 7, 8], 2)
    (3, 5, 7)
    """
    if every < 1:
        raise InputError("--every", found=str(every), expected="1 or more")
    return tuple(i for i in image_ids if (i - image_ids[0]) % every == 0)


def late_deliveries(stamps_ns: Sequence[int]) -> tuple[Delivery, ...]:
    """The late results, as indices into fed frames with these ascending timestamps.

    Request k is due 200 k ms after the first timestamp. It is for the newest frame at that time, and its
    result is delivered with the first frame that is 200 ms or more after this frame. Requests for the same
    frame are merged.

    >>> late_deliveries([round(i * 1e9 / 30) for i in range(14)])[:2]
    (Delivery(looked_at=0, delivered=6), Delivery(looked_at=6, delivered=12))
    """
    deliveries: list[Delivery] = []
    looked_at = 0
    due = stamps_ns[0]
    while due <= stamps_ns[-1] + _TOLERANCE_NS:
        while looked_at + 1 < len(stamps_ns) and stamps_ns[looked_at + 1] <= due + _TOLERANCE_NS:
            looked_at += 1
        if not deliveries or deliveries[-1].looked_at != looked_at:
            ready = stamps_ns[looked_at] + PERIOD_NS - _TOLERANCE_NS
            later = (i for i in range(looked_at + 1, len(stamps_ns)) if stamps_ns[i] >= ready)
            deliveries.append(Delivery(looked_at, next(later, None)))
        due += PERIOD_NS
    return tuple(deliveries)


class TrackerLike(Protocol):
    """A tracker to evaluate. A correction may be about the frame of the next `step`."""

    def correct(self, correction: Correction) -> Applied:
        """Apply a pose for a past frame."""
        ...

    def step(self, frame: RgbdFrame) -> Sequence[TrackedPose]:
        """Track one frame. Returns the poses as published."""
        ...


TrackerFactory = Callable[[Mapping[str, ReferenceModel]], TrackerLike]
Judge = Callable[[SourcedPose, TrackedPose | None], Verdict]


@dataclass(frozen=True)
class TrackOptions:
    """every: only every N-th frame is fed and scored; init, delayed: names of the sources of the first pose
    and of the late ones in the results."""

    protocol: Literal["free", "roft"] = "free"
    every: int = 1
    seeds: tuple[int, ...] = (0,)
    init: str = "gt"
    delayed: str | None = None


@dataclass(frozen=True, eq=False)
class Sources:
    """The sources of the first pose and, in `roft`, of the late ones."""

    init: PoseSource
    delayed: PoseSource | None = None


def evaluate_tracking(
    scenes: Sequence[Scene],
    targets: Targets,
    tracker_for: TrackerFactory,
    sources_for: Callable[[Scene, int], Sources],
    options: TrackOptions,
    *,
    judge: Judge | None = None,
    on_frame: Callable[[Sample, list[TrackRow]], None] | None = None,
) -> TrackResult:
    """Track every sequence with every seed, each with a new tracker with the models of the sequence's
    objects.

    sources_for: (sequence, seed) to sources; judge: gives the verdict on a late pose (default: it corrects).
    Raises InputError for sequences without labels of onboarded objects, or with the same name."""
    check_names(scenes)
    rows: list[TrackRow] = []
    phantoms: dict[tuple[str, int], int] = {}
    for seed in options.seeds:
        for scene in scenes:
            run = _Run(scene, targets, tracker_for, sources_for(scene, seed), options, seed, judge)
            for sample, new, spare in run.frames():
                rows += new
                phantoms[scene.name, seed] = phantoms.get((scene.name, seed), 0) + spare
                if on_frame is not None:
                    on_frame(sample, new)
    settings = {key: value for key, value in vars(options).items() if key != "seeds"}
    return TrackResult(rows, phantoms, settings)


class _Run:
    """One tracker on one sequence. Tracks have the numbers of the instances: the k-th label of an object is
    k."""

    def __init__(
        self,
        scene: Scene,
        targets: Targets,
        tracker_for: TrackerFactory,
        sources: Sources,
        options: TrackOptions,
        seed: int,
        judge: Judge | None,
    ) -> None:
        self.scene, self.targets, self.sources = scene, targets, sources
        self.options, self.seed, self.judge = options, seed, judge
        self.images = fed_images(scene.image_ids, options.every)
        self.counts = instance_counts(scene, self.images, targets)
        if not self.counts:
            raise InputError(
                f"sequence {scene.name}",
                found="no labelled pose of an onboarded object",
                fix="Onboard the object that the sequence shows, or choose another sequence.",
            )
        self.stamps_ns = [scene.stamp_ns(image) for image in self.images]
        for before, after in pairwise(range(len(self.images))):
            if self.stamps_ns[after] <= self.stamps_ns[before]:
                raise InputError(
                    f"sequence {scene.name}, image {self.images[after]}",
                    found=f"timestamp {self.stamps_ns[after]} ns",
                    expected=f"one later than {self.stamps_ns[before]} ns",
                )
        self.tracker = tracker_for({name: targets.models_by_name[name] for name in self.counts})
        self.asked_for: set[tuple[str, int]] = set()
        self.correction_counts: dict[tuple[str, int], int] = {}

    def frames(self) -> Iterator[tuple[Sample, list[TrackRow], int]]:
        """Each fed frame with its rows and the number of phantoms that are TRACKING; an unlabelled frame has
        neither."""
        roft = self.options.protocol == "roft"
        by_looked_at = {d.looked_at: d for d in late_deliveries(self.stamps_ns)} if roft else {}
        due: dict[int, list[Correction]] = {}
        for i in progress(range(len(self.images)), f"track {self.scene.name}"):
            sample = Sample.of(self.scene, self.images[i])
            here = places(sample.truths, self.targets, self.counts)
            corrections = due.pop(i, [])
            if i == 0 or not roft:
                corrections += self._first_poses(sample, here)
            start = time.perf_counter()
            for correction in corrections:
                self.tracker.correct(correction)
            tracked = self.tracker.step(sample.frame)
            seconds = time.perf_counter() - start
            if i in by_looked_at:
                self._look(by_looked_at[i], sample, here, tracked, due)
            if not has_labels(self.scene, sample.image):
                yield sample, [], 0
                continue
            published = [
                PublishedPose(t.object, t.instance, t.T_cam_obj, t.state, t.quality, t.velocity)
                for t in tracked
            ]
            where = self.scene.name, sample.image, sample.frame.stamp_ns
            yield sample, *rows_of_frame(*where, here, published, self.targets, seconds, self.seed)

    def _first_poses(self, sample: Sample, here: Sequence[Place]) -> list[Correction]:
        """The first pose of each instance is requested once, in the first fed frame that shows it. From a
        file it is requested until the file has a pose: a detector's poses may begin later (ROFT waits,
        too)."""
        new = [
            p
            for p in here
            if p.truth is not None and not p.truth.gone and (p.model.name, p.ordinal) not in self.asked_for
        ]
        found = self.sources.init.poses(sample, new, {}) if new else []
        from_file = isinstance(self.sources.init, FileSource)
        asked = [pose.place for pose in found] if from_file else new
        self.asked_for |= {(p.model.name, p.ordinal) for p in asked}
        return [self._correction(sample.frame, pose, Verdict.ACQUIRE) for pose in found]

    def _look(
        self,
        delivery: Delivery,
        sample: Sample,
        here: Sequence[Place],
        tracked: Sequence[TrackedPose],
        due: dict[int, list[Correction]],
    ) -> None:
        """Get the poses of the late source for this frame, and keep the corrections until they are due."""
        if self.sources.delayed is None or delivery.delivered is None:
            return
        known = {t.key: t for t in tracked if t.T_cam_obj is not None}
        priors = {}
        if self.judge is not None and delivery.looked_at > 0:
            priors = {key: PosePrior(t.T_cam_obj) for key, t in known.items() if t.T_cam_obj is not None}
        for pose in self.sources.delayed.poses(sample, here, priors):
            before = known.get((pose.place.model.name, pose.place.ordinal))
            verdict = Verdict.ACQUIRE if before is None else Verdict.CORRECT
            if self.judge is not None:
                verdict = self.judge(pose, before)
            if verdict is not Verdict.REJECT:
                correction = self._correction(sample.frame, pose, verdict)
                due.setdefault(delivery.delivered, []).append(correction)

    def _correction(self, frame: RgbdFrame, pose: SourcedPose, verdict: Verdict) -> Correction:
        key = (pose.place.model.name, pose.place.ordinal)
        self.correction_counts[key] = self.correction_counts.get(key, 0) + 1
        return Correction(
            object=key[0],
            instance=key[1],
            epoch=frame.epoch,
            frame_id=frame.frame_id,
            stamp_ns=frame.stamp_ns,
            T_cam_obj=pose.T_cam_obj,
            quality=pose.quality,
            verdict=verdict,
            seq=self.correction_counts[key],
            mask=pose.mask,
            present=None if pose.estimate is None else pose.estimate.present,
        )
