"""Late estimates are judged as in the live re-initialisation loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.estimation.types import ObjectQuery
from huepose.evaluation.instances import Place
from huepose.evaluation.sources import LoopJudge, SourcedPose
from huepose.geometry import se3
from huepose.tracking.types import TrackedPose, Verdict

from .conftest import HALF_TURN, estimate_of, pose_at

T = pose_at(0.0)


def tracked(T_cam_obj: np.ndarray, state: State = State.TRACKING) -> TrackedPose:
    return TrackedPose("box", 0, 0, 5, 5, state, T_cam_obj, None, 0.9, None, 1)


def late(models, T_cam_obj: np.ndarray, quality: float = 0.95, prior_score: float = 0.5, name: str = "box"):
    estimate = replace(estimate_of(ObjectQuery(name), T_cam_obj, quality), prior_score=prior_score)
    return SourcedPose(Place(models[name], 0, None), T_cam_obj, quality, None, estimate)


def moved(metres: float) -> np.ndarray:
    return se3.perturb(T, np.array([metres, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize(
    ("pose", "before", "verdict"),
    [
        (dict(T_cam_obj=moved(0.002)), tracked(T), Verdict.AGREE),
        (dict(T_cam_obj=moved(0.1)), tracked(T), Verdict.CORRECT),  # explains the image better: 0.8 over 0.5
        (dict(T_cam_obj=moved(0.1), prior_score=0.85), tracked(T), Verdict.REJECT),
        (dict(T_cam_obj=moved(0.1), quality=0.01), tracked(T), Verdict.REJECT),
        (dict(T_cam_obj=T), None, Verdict.ACQUIRE),
        (dict(T_cam_obj=T, quality=0.01), None, Verdict.REJECT),
        (dict(T_cam_obj=T @ HALF_TURN, name="brick"), tracked(T), Verdict.AGREE),  # it looks the same
    ],
)
def test_estimates_are_judged_against_the_tracked_pose(models, pose, before, verdict) -> None:
    assert LoopJudge(models)(late(models, **pose), before) is verdict


def test_labels_and_poses_of_files_are_accepted_without_judging(models) -> None:
    pose = SourcedPose(Place(models["box"], 0, None), moved(0.3), 1.0)
    assert LoopJudge(models)(pose, tracked(T)) is Verdict.CORRECT
    assert LoopJudge(models)(pose, None) is Verdict.ACQUIRE
