"""On depth as from an active stereo camera a static object does not jitter, and it starts without lag."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import Camera, RgbdFrame, se3
from huepose.rendering.render import render
from huepose.scenes.camera import STEREO
from huepose.scenes.sensor import stereo_depth
from huepose.tracking import Correction, Tracker

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
REST = 40


def at(x: float) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([1.9, 0.3, 0.4])), np.array([x, 0.0, 0.6]))


@pytest.fixture(scope="module")
def followed(tea_box):
    """Poses and truth of a box at rest for 40 frames and then pulled at 0.3 m/s for 8."""
    tracker, out = Tracker({"tea_box": tea_box}), []
    rendered = None
    for k in range(REST + 8):
        truth = at(-0.05 + 0.01 * max(0, k - REST + 1))
        if rendered is None or k >= REST:
            rendered = render([(tea_box.mesh, truth)], CAMERA)
        rng = np.random.default_rng([3, k])
        there = rendered.depth > 0
        behind = np.where(there, rendered.depth, np.float32(1.1))
        normals = np.where(there[..., None], rendered.normals_cam, np.array([0, 0, -1], np.float32))
        depth = stereo_depth(behind, normals.astype(np.float32), CAMERA, STEREO, rng)
        color = np.where(there[..., None], rendered.color, 90) + rng.normal(0.0, 2.0, rendered.color.shape)
        image = np.clip(color, 0, 255).astype(np.uint8)
        frame = RgbdFrame(image, depth, CAMERA, k, k * 33_333_333, 1)
        if k == 0:
            tracker.correct(Correction.first("tea_box", truth, frame, 1.0))
        out.append((tracker.step(frame)[0], truth))
    return out


def test_a_static_pose_does_not_jitter_and_its_covariance_is_true(followed) -> None:
    poses = followed[5:REST]
    assert {pose.state for pose, _ in poses} == {State.TRACKING}
    errors = np.array([se3.difference(truth, pose.T_cam_obj) for pose, truth in poses])
    jitter = errors - errors.mean(0)
    assert 1e3 * np.sqrt((jitter[:, :3] ** 2).sum(1).mean()) < 0.5
    assert np.degrees(np.sqrt((jitter[:, 3:] ** 2).sum(1).mean())) < 0.3
    sigmas = np.array([np.sqrt(np.diag(pose.covariance)) for pose, _ in poses])
    assert (np.abs(errors) < 2 * sigmas).mean() >= 0.95
    assert sigmas[:, :3].max() < 0.003, "the claimed uncertainty is small"


def test_motion_starts_without_lag(followed) -> None:
    behind = [truth[0, 3] - pose.T_cam_obj[0, 3] for pose, truth in followed[REST:]]
    assert np.abs(behind).max() < 0.001, "it moves by a centimetre per frame"
    speed = followed[-1][0].velocity[:3]
    np.testing.assert_allclose(speed, [0.3, 0.0, 0.0], atol=0.03)
