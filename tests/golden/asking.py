"""Asking: the estimator about single frames, and a tracker about a sequence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2

from huepose import Correction, Estimator, ObjectQuery, ReferenceModel, RgbdFrame, Tracker
from huepose.estimation import EstimatorConfig
from tests.golden.answers import Answer, Answers, ImageMeans

METHODS = ("full", "colorpair")


@dataclass(frozen=True, eq=False)
class Step:
    """A frame that a tracker is fed, and the corrections that arrive before it."""

    frame: RgbdFrame
    corrections: Sequence[Correction] = ()


def estimated(
    question: str,
    models: Mapping[str, ReferenceModel],
    method: str,
    shown: Iterable[tuple[RgbdFrame, Sequence[ObjectQuery]]],
) -> Answers:
    """The estimates of all objects of each frame, in one call; a number distinguishes instances of an
    object."""
    estimator = Estimator(models, EstimatorConfig(method=method))
    answers, images = [], []
    for frame, queries in shown:
        images.append(ImageMeans.of(question, frame))
        for pose in estimator.estimate(frame, queries):
            name = f"{pose.object} {pose.instance}"
            answers.append(Answer(question, frame.frame_id, name, pose.state, pose.quality, pose.T_cam_obj))
    return Answers(answers, images)


def tracked(question: str, models: Mapping[str, ReferenceModel], steps: Iterable[Step]) -> Answers:
    """The poses that a tracker publishes for every frame."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # as the tracker's worker does
    try:
        tracker, answers, images = Tracker(models), [], []
        for step in steps:
            images.append(ImageMeans.of(question, step.frame))
            for correction in step.corrections:
                tracker.correct(correction)
            for pose in tracker.step(step.frame):
                name = f"{pose.object} {pose.instance}"
                state = pose.state
                answers.append(
                    Answer(question, step.frame.frame_id, name, state, pose.quality, pose.T_cam_obj)
                )
        return Answers(answers, images)
    finally:
        cv2.setNumThreads(threads)
