"""What all single-frame baselines share: they get masked points and return a pose.

Each is wrapped as an estimator, so that HuePose's own evaluation runs it on the same instances, in the same
disturbed boxes, with the same masks and the same labels, and counts its CPU time per object.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from huepose.believe.state import State
from huepose.estimation import Estimator, ObjectQuery, PoseEstimate
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel
from huepose.perception.embedded import DepthSegmenter

FEWEST_POINTS = 30
"""Fewest pixels with depth in a mask for which the baseline is run."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Points (N, 3) m in camera axes under the mask, and their colours (N, 3) 0..1."""

    points_cam: Float64
    colors: Float64


class Rival(Protocol):
    """A baseline. `pose` returns T_cam_obj (4, 4), a fitness, and its CPU seconds; None for no pose."""

    def prepare(self, model: ReferenceModel) -> None:
        """Preparation, once per object; not counted."""
        ...

    def pose(self, model: ReferenceModel, seen: Seen) -> tuple[Float64, float, float] | None:
        """A pose from masked points."""
        ...


@dataclass(eq=False)
class RivalEstimator:
    """A baseline as an estimator. cpu_s: one value per object, without the segmenter, which all share."""

    rival: Rival
    models: Mapping[str, ReferenceModel]
    cpu_s: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._segmenter = DepthSegmenter()
        self._prepared: set[str] = set()

    def warm_up(self) -> None:
        """Does nothing: an object is prepared at its first query, which is not counted."""

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """One answer per query, from its mask or the segmenter's best one."""
        return [self._one(frame, query) for query in queries]

    def _one(self, frame: RgbdFrame, query: ObjectQuery) -> PoseEstimate:
        model = self.models[query.object]
        if model.name not in self._prepared:
            self.rival.prepare(model)
            self._prepared.add(model.name)
        masks = list(query.masks)
        if not masks and query.box is not None:
            masks = list(self._segmenter.segment(frame, query.box, model.diameter_m))
        found = None
        if masks:
            points = seen_under(frame, masks[0])
            if len(points.points_cam) >= FEWEST_POINTS:
                found = self.rival.pose(model, points)
        if found is None:
            self.cpu_s.append(0.0)
            return answer(query, None, 0.0)
        T, fitness, seconds = found
        self.cpu_s.append(seconds)
        return answer(query, T, fitness)


@dataclass(eq=False)
class Ours:
    """HuePose's estimator with its CPU time counted per object, including its segmenter. together: all
    objects of a frame are estimated in one call, so that they compete for its depth; else each alone, like
    the baselines."""

    estimator: Estimator
    together: bool = False
    cpu_s: list[float] = field(default_factory=list)

    def warm_up(self) -> None:
        """Compile the kernels and load the objects, which is not counted."""
        self.estimator.warm_up()

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """One answer per query."""
        answers = []
        for asked in [queries] if self.together else [[query] for query in queries]:
            start = time.process_time()
            answers += self.estimator.estimate(frame, asked)
            self.cpu_s += [(time.process_time() - start) / len(asked)] * len(asked)
        return answers


def seen_under(frame: RgbdFrame, mask: np.ndarray) -> Seen:
    """Points and colours of the pixels under a mask (H, W) that have depth."""
    rows, columns = np.nonzero(mask & (frame.depth > 0))
    pixels = np.stack([columns, rows], -1).astype(np.float64)
    points = frame.camera.backproject(pixels, frame.depth[rows, columns].astype(np.float64))
    return Seen(points, frame.color[rows, columns] / 255.0)


def answer(query: ObjectQuery, T_cam_obj: Float64 | None, fitness: float) -> PoseEstimate:
    """A pose as an estimate, for the evaluation."""
    found = T_cam_obj is not None
    return PoseEstimate(
        query.object,
        query.instance,
        found,
        T_cam_obj,
        quality=float(np.clip(fitness, 0.0, 1.0)),
        state=State.SUSPECT if found else State.LOST,
        score=fitness,
        box=query.box,
    )
