"""Colour pairs that a picture shows agree at the right pose, and many are contradicted at a turned one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from huepose.geometry import RgbdFrame, se3
from huepose.judge.pairs_seen import pairs_seen
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth


def test_the_right_pose_is_agreed_with_and_a_turned_one_is_not(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    pixels, elsewhere = pairs_seen(frame, tea_box, standing)
    assert len(pixels) > 50
    assert elsewhere.mean() < 0.05
    columns, rows = np.rint(pixels).astype(int).T
    assert (render_depth(tea_box.mesh, standing, frame.camera)[rows, columns] > 0).mean() > 0.95
    turned = standing @ se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    pixels, elsewhere = pairs_seen(frame, tea_box, turned)
    assert len(pixels) > 10
    assert elsewhere.mean() > 0.2


def test_what_is_outside_of_the_picture_has_none(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame]
) -> None:
    away = se3.make(np.eye(3), np.array([5.0, 0.0, 1.0]))
    pixels, elsewhere = pairs_seen(take_picture([]), tea_box, away)
    assert pixels.shape == (0, 2)
    assert elsewhere.shape == (0,)
