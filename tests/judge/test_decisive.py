"""Pixels whose depth only one of two poses explains."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.geometry.box import Box
from huepose.judge.decisive import decisive_balance
from huepose.rendering.render import render_depth

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
AT = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
BOX = Box(60.0, 40.0, 200.0, 160.0)
MUCH_NEARER = 0.3


def bar_with_a_peg() -> Mesh:
    """Two boxes: a bar along x, and a peg on its right half towards the camera."""
    parts = [((-0.06, -0.02, -0.02), (0.06, 0.02, 0.02)), ((0.03, -0.01, -0.06), (0.05, 0.01, -0.02))]
    corners, faces = [], []
    for low, high in parts:
        first = len(corners)
        corners += [
            [(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]]
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        ]
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces += [
            [first + a, first + b, first + c]
            for q in quads
            for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))
        ]
    face = np.array(faces, np.int32)
    return Mesh(
        np.array(corners, np.float32),
        face,
        np.zeros((len(face), 3, 2), np.float32),
        np.full((4, 4, 3), 90, np.uint8),
    )


PEG = bar_with_a_peg()
OTHER = AT @ se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def seen(T: np.ndarray, background_m: float = 1.0) -> RgbdFrame:
    depth = render_depth(PEG, T, CAMERA)
    depth[depth == 0.0] = background_m
    return RgbdFrame(np.zeros((240, 320, 3), np.uint8), depth, CAMERA)


def test_the_peg_tells_the_right_pose_from_half_a_turn() -> None:
    """The peg and what it occludes is a fifth of the silhouette; all of its pixels are for the right pose."""
    frame = seen(AT)
    right = decisive_balance(PEG, AT, OTHER, BOX, frame)
    assert right > 0.4
    assert decisive_balance(PEG, OTHER, AT, BOX, frame) == pytest.approx(-right)


def test_equal_poses_differ_in_no_pixel() -> None:
    assert decisive_balance(PEG, AT, AT, BOX, seen(AT)) == 0.0


@pytest.mark.parametrize("background_m", [0.0, MUCH_NEARER])
def test_an_occluded_or_unknown_peg_tells_nothing(background_m: float) -> None:
    """Where another thing or no reading is, neither pose explains the depth."""
    frame = seen(AT, background_m)
    for T in (AT, OTHER):
        top = render_depth(PEG, T, CAMERA) < 0.57
        frame.depth[top & (render_depth(PEG, T, CAMERA) > 0.0)] = background_m
    assert abs(decisive_balance(PEG, AT, OTHER, BOX, frame)) < 0.1


def test_outside_of_the_image_nothing_is_compared() -> None:
    assert decisive_balance(PEG, AT, OTHER, Box(400.0, 40.0, 50.0, 50.0), seen(AT)) == 0.0


def test_a_large_object_is_compared_in_fewer_pixels() -> None:
    near = se3.make(np.eye(3), np.array([0.0, 0.0, 0.25]))
    turned = near @ se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    assert decisive_balance(PEG, near, turned, Box(0.0, 0.0, 320.0, 240.0), seen(near)) > 0.4
