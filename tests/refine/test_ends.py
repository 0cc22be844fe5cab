"""A pose that slid along a plain face is moved back to the ends of the object."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.judge.borders import Contours
from huepose.judge.open_region import PreparedSurface
from huepose.model import ReferenceModel
from huepose.refine.ends import moved_to_ends
from huepose.rendering import render
from tests.onboarded import times_as_large

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)
T = se3.make(se3.rotation_exp(np.array([1.4, 0.2, 0.1])), np.array([0.02, -0.01, 0.6]))


@pytest.fixture(scope="module")
def contours(tea_box: ReferenceModel) -> Contours:
    """The contours of a box; its print is not used."""
    return Contours(tea_box.mesh, PreparedSurface.of(tea_box))


def frame(contours: Contours, behind_m: float) -> RgbdFrame:
    """The box in front of a wall, with noise of 1 mm."""
    depth = render([(contours.mesh, T)], CAMERA).depth
    depth = np.where(depth > 0, depth, behind_m) + np.random.default_rng(3).normal(0, 0.001, depth.shape)
    return RgbdFrame(np.full((240, 320, 3), 180, np.uint8), depth.astype(np.float32), CAMERA)


def error_m(contours: Contours, pose: np.ndarray) -> float:
    points = contours.mesh.vertices
    return float(np.linalg.norm(se3.apply(pose, points) - se3.apply(T, points), axis=1).mean())


def test_a_box_that_slid_is_moved_back_to_its_ends(contours: Contours) -> None:
    face = T[:3, :3] @ np.array([0.0, 1.0, 0.0])  # the normal of its largest visible side
    aside = np.cross(face, [0.0, 1.0, 0.0])
    slid = T.copy()
    slid[:3, 3] += 0.018 * aside / np.linalg.norm(aside)
    assert error_m(contours, slid) > 0.017
    found = moved_to_ends(contours, slid, frame(contours, 1.2))
    assert found is not None
    assert error_m(contours, found) < 0.003


def test_a_right_pose_stays(contours: Contours) -> None:
    found = moved_to_ends(contours, T, frame(contours, 1.2))
    assert found is not None
    assert error_m(contours, found) < 0.002


def test_without_a_step_in_depth_there_is_no_answer(contours: Contours) -> None:
    flat = frame(contours, 1.2)
    wall = RgbdFrame(flat.color, np.full((240, 320), 0.57, np.float32), CAMERA)
    assert moved_to_ends(contours, T, wall) is None


@pytest.fixture(scope="module")
def large(tea_box: ReferenceModel) -> Contours:
    """The contours of a box of a metre."""
    return Contours.of(times_as_large(tea_box, 1.0 / 0.15))


@pytest.mark.parametrize("turn", [(1.1, 0.3, 0.8), (0.9, -0.5, 0.3), (1.2, 0.6, -0.4)])
def test_a_right_pose_of_an_object_of_a_metre_stays_as_exactly(
    large: Contours, turn: tuple[float, float, float]
) -> None:
    """Its outline is known within millimetres, as that of a small one."""
    camera = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
    there = se3.make(se3.rotation_exp(np.array(turn)), np.array([0.05, -0.03, 2.2]))
    depth = render([(large.mesh, there)], camera).depth
    depth = np.where(depth > 0, depth, 4.5) + np.random.default_rng(3).normal(0, 0.001, depth.shape)
    seen = RgbdFrame(np.full((480, 640, 3), 180, np.uint8), depth.astype(np.float32), camera)
    found = moved_to_ends(large, there, seen)
    assert found is not None
    away = np.linalg.norm(large.surface.centre_cam(found) - large.surface.centre_cam(there))
    assert away < 0.0015
    assert np.degrees(se3.rotation_angle(found, there)) < 1.0
