"""VSD, MSSD, MSPD and average recall on cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.evaluation.bop_errors import (
    BopErrors,
    BopObject,
    BopScore,
    average_recalls,
    bop_errors,
    matched_recalls,
    mssd_mspd,
    vsd,
)
from huepose.geometry import Camera, se3

from .conftest import CAMERA, HALF_TURN, box_mesh

LONG = Camera(1e5, 1e5, 4.5, 4.5, 10, 10)
"""All its rays run along z, so that distances are depths."""


def at(x: float, y: float, z: float, angle: float = 0.0) -> np.ndarray:
    """T_cam_obj, rotated about the camera's z axis."""
    return se3.make(se3.rotation_exp([0, 0, angle]), [x, y, z])


def flat(depth_m: float, columns: slice = slice(None)) -> np.ndarray:
    depth = np.zeros((10, 10), np.float32)
    depth[:, columns] = depth_m
    return depth


def test_vsd_counts_pixels_that_are_farther_apart_than_the_tolerance() -> None:
    """20.1 mm at a diameter of 100 mm: wrong at 5, 10, 15 and 20 %, right from 25 % on."""
    errors = vsd(flat(1.0201), flat(1.0), flat(0.0), LONG, 0.1)
    np.testing.assert_allclose(errors, [1, 1, 1, 1, 0, 0, 0, 0, 0, 0])


def test_vsd_counts_pixels_that_only_one_surface_covers() -> None:
    """The estimate covers 6 of the label's 10 columns; 2 of these are 30 mm too far: 4/10, 6/10."""
    estimate = flat(1.0, slice(0, 6))
    estimate[:, :2] = 1.0301
    errors = vsd(estimate, flat(1.0), flat(1.0), LONG, 0.1)
    np.testing.assert_allclose(errors, [0.6] * 6 + [0.4] * 4)


def test_vsd_leaves_out_occluded_pixels_and_keeps_those_without_depth() -> None:
    """3 columns are occluded by a surface 20 mm nearer, 2 have no depth; 1 visible column is missing."""
    measured = flat(1.0)
    measured[:, :3], measured[:, 8:] = 0.98, 0.0
    estimate = flat(1.0, slice(0, 9))
    np.testing.assert_allclose(vsd(estimate, flat(1.0), measured, LONG, 0.1), [1 / 7] * 10)
    measured[:, :3] = 0.986  # within 15 mm: not occluded
    np.testing.assert_allclose(vsd(estimate, flat(1.0), measured, LONG, 0.1), [1 / 10] * 10)


def test_vsd_without_visible_pixels_is_one() -> None:
    np.testing.assert_array_equal(vsd(flat(0.0), flat(0.0), flat(1.0), LONG, 0.1), np.ones(10))


def test_surface_and_projection_distances_by_hand() -> None:
    """A plate at 0.5 m moved by 10 mm along x: 10 mm, and 120 px * 0.01 / 0.5 = 2.4 px."""
    plate = np.array([[x, y, 0.0] for x in (-0.05, 0.05) for y in (-0.02, 0.02)])
    T, moved = at(0.0, 0.0, 0.5), at(0.01, 0.0, 0.5)
    only = np.eye(4)[None]
    np.testing.assert_allclose(mssd_mspd(plate, moved, T, only, CAMERA), (0.01, 2.4))
    turned = T @ HALF_TURN
    wide = 2 * np.hypot(0.05, 0.02)
    np.testing.assert_allclose(mssd_mspd(plate, turned, T, only, CAMERA), (wide, wide * 120 / 0.5))
    both = np.stack([np.eye(4), HALF_TURN])
    np.testing.assert_allclose(mssd_mspd(plate, turned, T, both, CAMERA), (0, 0), atol=1e-12)


def test_an_object_takes_symmetries_and_diameter_from_the_data_set() -> None:
    info = {"diameter": 200.0, "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    obj = BopObject.of(box_mesh((0.1, 0.1, 0.1)), info)
    assert (obj.diameter_m, len(obj.symmetries)) == (0.2, 315)
    T = at(0.0, 0.0, 0.6)
    depth = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    right = bop_errors(obj, T, T, depth, CAMERA)
    assert (max(right.vsd), right.mssd, right.mspd_px) == (0.0, 0.0, 0.0)
    farther = bop_errors(obj, at(0.0, 0.0, 0.62), T, depth, CAMERA)
    assert farther.mssd == pytest.approx(0.1)  # 20 mm of 200
    # The corner nearest to the camera moves most: 50 mm off the axis, from 550 to 570 mm away; 160 columns.
    assert farther.mspd_px == pytest.approx(4 * 120 * np.hypot(0.05, 0.05) * (1 / 0.55 - 1 / 0.57))
    assert bop_errors(obj, None, T, depth, CAMERA) == BopErrors.missing()


def alone(errors: BopErrors) -> dict[str, object]:
    """The record of the only label of an object, as in the result file."""
    return BopScore(errors, matched_recalls([[errors]])[0]).as_json()


def mssd_of(error: float) -> BopErrors:
    return BopErrors((error,) * 10, error, 100.0 * error)


def test_average_recall_by_hand() -> None:
    """One exact pose, one missing, one with 12 % MSSD, 22 px, and VSD 0.3 at all tolerances."""
    exact = alone(BopErrors((0.0,) * 10, 0.0, 0.0))
    middle = alone(BopErrors((0.3,) * 10, 0.12, 22.0))
    recalls = average_recalls([exact, middle, alone(BopErrors.missing())])
    assert recalls["ar_vsd"] == pytest.approx(100 * (1 + 0.4) / 3)  # right at 35, 40, 45 and 50 %
    assert recalls["ar_mssd"] == pytest.approx(100 * (1 + 0.8) / 3)  # right from 15 % on
    assert recalls["ar_mspd"] == pytest.approx(100 * (1 + 0.6) / 3)  # right from 25 px on
    assert recalls["ar"] == pytest.approx(100 * (3 + 1.8) / 9)
    assert average_recalls([])["ar"] is None


def test_an_error_at_the_threshold_is_too_large() -> None:
    assert matched_recalls([[BopErrors((0.5,) * 10, 0.5, 50.0)]]) == [(0.0, 0.0, 0.0)]
    assert matched_recalls([[BopErrors((0.0,) * 10, 0.0, 45.0)]]) == [(1.0, 1.0, pytest.approx(0.1))]


def test_instances_are_matched_to_labels_the_most_confident_pose_first() -> None:
    """As in bop_toolkit's pose_matching.match_poses. Two right poses whose order is exchanged are right. The
    more confident pose takes its nearest label; the other pose gets the rest."""
    a, b, c = (mssd_of(error) for error in (0.02, 0.12, 0.32))
    crossed = matched_recalls([[BopErrors.missing(), a], [a, BopErrors.missing()]])
    assert crossed == [(1.0, 1.0, 1.0)] * 2
    # From 5 % on, the more confident pose has the first label. The other is 32 % from the label that is left.
    confident_first = matched_recalls([[a, b], [b, c]])
    assert [s[1] for s in confident_first] == [pytest.approx(1.0), pytest.approx(0.4)]
    # The more confident pose is worse: up to 10 % the other one has the first label, then this one takes it.
    confident_worse = matched_recalls([[b, c], [a, c]])
    assert [s[1] for s in confident_worse] == [pytest.approx(1.0), pytest.approx(0.4)]
    # Both poses lie on one label: the other label is missed.
    same = matched_recalls([[a, BopErrors.missing()], [b, BopErrors.missing()]])
    assert [s[1] for s in same] == [1.0, 0.0]


def test_errors_do_not_change_if_the_scene_is_rolled_about_the_optical_axis() -> None:
    points = box_mesh((0.1, 0.2, 0.3)).vertices
    T, other = at(0.02, 0.0, 0.6, 0.3), at(0.03, 0.01, 0.62, 0.4)
    roll = se3.make(se3.rotation_exp([0, 0, 1.1]), np.zeros(3))
    square = Camera(120.0, 120.0, 79.5, 79.5, 160, 160)
    here = mssd_mspd(points, other, T, np.eye(4)[None], square)
    np.testing.assert_allclose(mssd_mspd(points, roll @ other, roll @ T, np.eye(4)[None], square), here)
