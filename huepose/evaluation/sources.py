"""Sources of a tracker's first pose and of its late poses: our estimator, the labels, or a file.

The rules of the live re-initialisation loop decide what a late estimate means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from huepose.datasets.boxes import disturbed, truth_box
from huepose.datasets.types import GroundTruth, Sample
from huepose.estimation.types import ObjectQuery, PoseEstimate, PosePrior
from huepose.evaluation.estimate_protocol import PoseEstimator
from huepose.evaluation.instances import Place
from huepose.evaluation.pose_files import PoseTable
from huepose.geometry.arrays import Bool, Float64
from huepose.model.types import ReferenceModel
from huepose.reinit.config import ReinitConfig
from huepose.reinit.judge import judge_tracked, usable
from huepose.reinit.types import ObjectSlot, Prior
from huepose.tracking.types import TrackedPose, Verdict

Priors = Mapping[tuple[str, int], PosePrior]
"""Pose priors of the tracked instances, by (object, ordinal)."""


@dataclass(frozen=True, eq=False)
class SourcedPose:
    """A pose of one instance in the requested frame. estimate: the estimate it comes from, if it does."""

    place: Place
    T_cam_obj: Float64
    quality: float
    mask: Bool | None = None
    estimate: PoseEstimate | None = None


class PoseSource(Protocol):
    """Gives poses for one frame; instances without a pose are missing from the result."""

    def poses(self, sample: Sample, places: Sequence[Place], priors: Priors) -> list[SourcedPose]:
        """Poses of the instances that have a label in the frame."""
        ...


class TruthSource:
    """The labels, with their masks."""

    def poses(self, sample: Sample, places: Sequence[Place], priors: Priors) -> list[SourcedPose]:
        """The labelled poses of the instances of which at least a tenth is visible."""
        return [
            SourcedPose(place, truth.T_cam_obj, 1.0, truth.mask())
            for place, truth in _present(places)
            if truth.T_cam_obj is not None
        ]


@dataclass(eq=False)
class EstimatorSource:
    """Our estimator in the disturbed box of each instance. The poses of a frame are cached."""

    estimator: PoseEstimator
    seed: int
    _answers: dict[tuple[str, int], list[SourcedPose]] = field(default_factory=dict)

    def poses(self, sample: Sample, places: Sequence[Place], priors: Priors) -> list[SourcedPose]:
        """The poses that were found."""
        key = (sample.scene, sample.image)
        if key not in self._answers:
            self._answers[key] = self._estimate(sample, places, priors)
        return self._answers[key]

    def _estimate(self, sample: Sample, places: Sequence[Place], priors: Priors) -> list[SourcedPose]:
        camera = sample.frame.camera
        asked: dict[int, Place] = {}
        queries = []
        for place, truth in _present(places):
            box = truth_box(truth, place.model.mesh, camera)
            if box is None:
                continue
            where = (sample.scene, sample.image, truth.instance)
            box = disturbed(box, "perturbed", self.seed, *where, camera)
            prior = priors.get((place.model.name, place.ordinal))
            queries.append(ObjectQuery(place.model.name, box=box, prior=prior, instance=truth.instance))
            asked[truth.instance] = place
        answers = self.estimator.estimate(sample.frame, queries) if queries else []
        return [
            SourcedPose(asked[a.instance], a.T_cam_obj, a.quality, a.mask, a)
            for a in answers
            if a.found and a.T_cam_obj is not None
        ]


@dataclass(frozen=True, eq=False)
class FileSource:
    """Poses from a file, without masks. They belong to the first instance of each object."""

    table: PoseTable

    def poses(self, sample: Sample, places: Sequence[Place], priors: Priors) -> list[SourcedPose]:
        """The poses in the file for this frame."""
        found = []
        for place in places:
            T_cam_obj = self.table.pose(sample.image, place.model.name, place.model.object_id)
            if T_cam_obj is not None and place.ordinal == 0:
                found.append(SourcedPose(place, T_cam_obj, 1.0))
        return found


def _present(places: Sequence[Place]) -> list[tuple[Place, GroundTruth]]:
    return [(p, p.truth) for p in places if p.truth is not None and not p.truth.gone]


class LoopJudge:
    """Verdicts on late poses. Poses without an estimate (labels, files) are always accepted.

    Here the instance of an estimate is known. So an object without a pose takes every usable estimate at
    once; the tracker still verifies it on its own frame before it is published."""

    def __init__(self, models: Mapping[str, ReferenceModel]) -> None:
        self._config = ReinitConfig()
        self._slots = {name: ObjectSlot.of(model) for name, model in models.items()}

    def __call__(self, pose: SourcedPose, tracked: TrackedPose | None) -> Verdict:
        """tracked: the pose that was published for the frame of the estimate, None without a pose."""
        if pose.estimate is None:
            return Verdict.CORRECT if tracked is not None else Verdict.ACQUIRE
        if tracked is None or tracked.T_cam_obj is None:
            return Verdict.ACQUIRE if usable(pose.estimate, self._config) else Verdict.REJECT
        slot = self._slots[pose.place.model.name]
        prior = Prior(tracked.T_cam_obj, tracked.velocity, tracked.covariance, tracked.stamp_ns)
        return judge_tracked(pose.estimate, prior, tracked.stamp_ns, tracked.state, slot, self._config)
