"""Colour pairs agree with an image in the right pose, and many contradict it in a rotated one."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.judge.pairs_seen import pairs_seen
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture


def test_pairs_agree_with_the_right_pose_and_not_with_a_rotated_one(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    upside_down = se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    right, wrong = [], []
    for turn in np.radians([0.0, 10.0, 20.0, 30.0]):
        pose = standing @ se3.make(se3.rotation_exp(np.array([0.0, 0.0, turn])), np.zeros(3))
        frame = take_picture([(tea_box.mesh, pose)])
        pixels, elsewhere = pairs_seen(frame, tea_box, pose)
        assert len(pixels) > 30
        columns, rows = np.rint(pixels).astype(int).T
        assert (render_depth(tea_box.mesh, pose, frame.camera)[rows, columns] > 0).mean() > 0.95
        right.append(elsewhere.mean())
        pixels, elsewhere = pairs_seen(frame, tea_box, pose @ upside_down)
        assert len(pixels) > 10
        wrong.append(elsewhere.mean())
    assert np.mean(right) < 0.12
    assert min(wrong) > 0.4


def test_a_pose_outside_of_the_image_has_no_pairs(tea_box: ReferenceModel, take_picture: TakePicture) -> None:
    away = se3.make(np.eye(3), np.array([5.0, 0.0, 1.0]))
    pixels, elsewhere = pairs_seen(take_picture([]), tea_box, away)
    assert pixels.shape == (0, 2)
    assert elsewhere.shape == (0,)
