"""Asking: the estimator about single frames, and a tracker about a sequence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2

from huepose import Correction, Estimator, ObjectQuery, ReferenceModel, RgbdFrame, Tracker
from huepose.estimation import EstimatorConfig
from tests.golden.answers import Answer, Answers, Picture

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
    """All objects of each frame in one call; several instances of an object are told apart by number."""
    estimator = Estimator(models, EstimatorConfig(method=method))
    answers, pictures = [], []
    for frame, queries in shown:
        pictures.append(Picture.of(question, frame))
        for pose in estimator.estimate(frame, queries):
            name = f"{pose.object} {pose.instance}"
            answers.append(Answer(question, frame.frame_id, name, pose.state, pose.quality, pose.T_cam_obj))
    return Answers(answers, pictures)


def tracked(question: str, models: Mapping[str, ReferenceModel], steps: Iterable[Step]) -> Answers:
    """What is published for every frame."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # as the tracker's worker does
    try:
        tracker, answers, pictures = Tracker(models), [], []
        for step in steps:
            pictures.append(Picture.of(question, step.frame))
            for correction in step.corrections:
                tracker.correct(correction)
            for pose in tracker.step(step.frame):
                name = f"{pose.object} {pose.instance}"
                state = pose.state
                answers.append(
                    Answer(question, step.frame.frame_id, name, state, pose.quality, pose.T_cam_obj)
                )
        return Answers(answers, pictures)
    finally:
        cv2.setNumThreads(threads)
