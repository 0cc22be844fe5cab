"""A broken baseline would make our results look better, so each must do what it is known for."""

import sys
from pathlib import Path

import numpy as np
import pytest

from huepose.evaluation import metrics
from huepose.geometry import se3
from huepose.model.types import ReferenceModel
from huepose.rendering import render_depth

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from open3d_rivals import Features, ManyStarts
from rival import Seen, seen_under
from track_rivals import LastPoseTracker, careful_icp, color_icp, flow_pairs

from huepose.tracking.types import Correction


def test_careful_icp_corrects_a_centimetre_and_five_degrees(tea_box, box_frame, standing) -> None:
    turned = se3.rotation_exp(np.radians([0.0, 4.0, 3.0])) @ standing[:3, :3]
    start = se3.make(turned, standing[:3, 3] + [0.006, -0.005, 0.006])
    T = careful_icp(tea_box, start, None, box_frame)
    assert metrics.adds(tea_box.eval_points, T, standing) < 0.001
    assert metrics.add(tea_box.eval_points, T, standing) < 0.002


@pytest.mark.parametrize("step", [color_icp, flow_pairs])
def test_colour_based_steps_follow_a_small_motion(tea_box, take_picture, standing, step) -> None:
    moved = standing.copy()
    moved[:3, 3] += [0.006, 0.0, 0.0]
    before, now = (take_picture([(tea_box.mesh, T)], frame_id=k) for k, T in enumerate((standing, moved)))
    T = step(tea_box, standing, before, now)
    assert metrics.add(tea_box.eval_points, T, moved) < 0.003


def test_constant_velocity_starts_at_the_predicted_pose(tea_box, take_picture, standing) -> None:
    starts = []

    def noted(model, T, before, frame):
        starts.append(T)
        return T

    steady = [se3.make(np.eye(3), [0.01 * k, 0.0, 0.0]) @ standing for k in range(3)]
    tracker = LastPoseTracker({"tea_box": tea_box}, noted, constant_velocity=True)
    frame = take_picture([(tea_box.mesh, standing)])
    tracker.correct(Correction.first("tea_box", steady[0], frame, 1.0))
    tracker.step(frame)
    tracker.step(frame)
    tracker._poses["tea_box", 0] = [steady[0], steady[1]]
    tracker.step(frame)
    np.testing.assert_allclose(starts[-1], steady[2], atol=1e-9)


def _whole(model: ReferenceModel, T: np.ndarray, take_picture) -> Seen:
    frame = take_picture([(model.mesh, T)], with_table=False)
    return seen_under(frame, render_depth(model.mesh, T, frame.camera) > 0)


@pytest.mark.parametrize("rival", [Features(fast=False), ManyStarts()])
def test_registration_by_shape_aligns_the_box_with_its_points(tea_box, take_picture, standing, rival) -> None:
    rival.prepare(tea_box)
    found = rival.pose(tea_box, _whole(tea_box, standing, take_picture))
    assert found is not None
    assert metrics.adds(tea_box.eval_points, found[0], standing) < 0.1 * tea_box.diameter_m
    assert found[2] > 0


def test_registration_by_colour_does_not_flip_the_box(tea_box, take_picture, standing) -> None:
    rival = ManyStarts(by_color=True)
    rival.prepare(tea_box)
    found = rival.pose(tea_box, _whole(tea_box, standing, take_picture))
    assert found is not None
    assert metrics.add(tea_box.eval_points, found[0], standing) < 0.1 * tea_box.diameter_m
