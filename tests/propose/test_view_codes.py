"""Views and windows of an object in the same form, and codes that find a view for a window."""

from __future__ import annotations

import hashlib
import json

import cv2
import numpy as np
import pytest

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float32
from huepose.model.types import ReferenceModel
from huepose.propose.view_codes import WEIGHTS, codes_of_views, codes_of_windows
from huepose.propose.view_images import (
    MAX_STEP,
    NEAR,
    ROLLS,
    SIDE,
    SPAN,
    STEP,
    ZERO,
    Pyramid,
    clean_view,
    network_input,
    turned,
    upright_views,
    window_images,
)
from huepose.propose.views import onto_rays
from tests.conftest import TakePicture


@pytest.fixture(scope="module")
def codes(tea_box: ReferenceModel) -> Float32:
    return codes_of_views(tea_box.mesh, tea_box.diameter_m)


def test_a_view_is_as_wide_as_it_says_and_its_middle_is_where_it_says(tea_box: ReferenceModel) -> None:
    R = icosphere.look_at(np.array([0.0, 0.0, 1.0]))
    view = clean_view(tea_box.mesh, tea_box.diameter_m, R)
    rows, columns = np.nonzero(np.isfinite(view.relief))
    size = np.ptp(tea_box.mesh.vertices @ R.T, axis=0)
    shown = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1]) * SPAN * tea_box.diameter_m / SIDE
    assert shown == pytest.approx(size[:2], rel=0.05)
    assert np.array([columns.mean(), rows.mean()]) == pytest.approx((SIDE - 1) / 2, abs=0.6)
    # The visible side lies half a box in front of the middle of the mesh.
    assert view.middle_m == pytest.approx([0.0, 0.0, -size[2] / 2], abs=0.004)
    assert (view.color[np.isnan(view.relief)] == 0).all()


def test_a_roll_rotates_a_view_clockwise(tea_box: ReferenceModel) -> None:
    R = icosphere.look_at(icosphere.directions(1)[7])
    _, reliefs = turned(*upright_views(tea_box.mesh, tea_box.diameter_m))
    rolled = se3.rotation_exp(np.array([0.0, 0.0, 2 * np.pi * 2 / ROLLS])) @ R
    afresh = clean_view(tea_box.mesh, tea_box.diameter_m, rolled).relief
    there = np.isfinite(reliefs[7 * ROLLS + 2]), np.isfinite(afresh)
    assert (there[0] & there[1]).sum() > 0.9 * (there[0] | there[1]).sum()


def test_a_window_is_read_at_metric_scale_and_unknown_depth_says_so() -> None:
    color = np.zeros((100, 120, 3), np.uint8)
    color[:, 60:] = 200
    depth = np.full((100, 120), 0.6, np.float32)
    depth[:50] = 0.0
    middle = np.array([[59.5, 49.5]])
    colors, reliefs = window_images(Pyramid(color), depth, middle, np.array([0.5]), np.array([64.0]), 0.2)
    assert colors[0, 10, [5, -5], 0].tolist() == [0, 200]
    assert np.isnan(reliefs[0, :30]).all()
    assert reliefs[0, 34:] == pytest.approx(0.5)
    x = network_input(colors, reliefs, clean=False)
    assert x.shape == (1, SIDE, SIDE, 8)
    numbers = (x[0].astype(np.float64) - ZERO) * STEP
    assert (numbers[:30, :, 3:6] == 0).all()
    assert numbers[34:, :, 4:6] == pytest.approx(1.0, abs=0.005)
    assert numbers[40, 40, 3] == pytest.approx(1.0, abs=0.005)
    assert numbers[10, -5, 0] == pytest.approx(200 / 127.5 - 1, abs=0.005)


@pytest.mark.parametrize("clean", [False, True])
def test_the_network_input_holds_the_quantised_numbers(clean: bool) -> None:
    rng = np.random.default_rng(1)
    colors = rng.integers(0, 256, (3, SIDE, SIDE, 3)).astype(np.uint8)
    reliefs = rng.normal(0.0, 0.4, (3, SIDE, SIDE)).astype(np.float32)
    reliefs[0] = (np.arange(SIDE * SIDE).reshape(SIDE, SIDE) / 8 - 256) * STEP / 2  # halves of a step, too
    known = rng.random(reliefs.shape) < 0.8
    near = np.float32(NEAR)
    level = np.where(known, reliefs, np.float32(0.0))
    color = colors * np.float32(2.0 / 255.0) - np.float32(1.0)
    color[~known & clean] = 0.0
    relief = np.clip(level, -near, near) * np.float32(2.0)
    numbers = np.concatenate([color, np.stack([relief, known, known & (abs(level) < near)], -1)], -1)
    x = network_input(colors, np.where(known, reliefs, np.float32(np.nan)), clean=clean)
    assert np.array_equal(x[..., :6], np.clip(np.rint(numbers.astype(np.float32) / STEP) + ZERO, 0, 255))


def test_windows_read_the_nearest_depth_and_the_image_halved_until_its_steps_are_short() -> None:
    rng = np.random.default_rng(3)
    color = rng.integers(0, 256, (120, 160, 3)).astype(np.uint8)
    depth = rng.uniform(0.4, 0.6, (120, 160)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0.0
    pixels, span_px = rng.uniform(-10.0, 170.0, (40, 2)), rng.uniform(20.0, 200.0, 40)
    colors, reliefs = window_images(Pyramid(color), depth, pixels, np.full(40, 0.5), span_px, 0.25)
    half, (size, flags) = cv2.pyrDown(color), ((SIDE, SIDE), cv2.WARP_INVERSE_MAP)
    for k, step in enumerate(span_px / SIDE):
        middle = (SIDE - 1) / 2.0 * step
        back = np.array([[step, 0.0, pixels[k, 0] - middle], [0.0, step, pixels[k, 1] - middle]])
        z = cv2.warpAffine(depth, back, size, flags=flags | cv2.INTER_NEAREST)
        expected = np.where(z > 0, (z - np.float32(0.5)) / np.float32(0.25), np.nan)
        np.testing.assert_array_equal(reliefs[k], expected)
        halved = step > MAX_STEP
        back = back / 2.0 - [[0.0, 0.0, 0.25]] if halved else back
        shown = cv2.warpAffine(half if halved else color, back, size, flags=flags | cv2.INTER_LINEAR)
        np.testing.assert_array_equal(colors[k], shown)


@pytest.mark.parametrize("yaw", [0.0, 0.9, 2.6])
def test_one_of_the_likest_views_of_an_object_on_a_table_is_near_its_orientation(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray, codes: Float32, yaw: float
) -> None:
    T = standing @ se3.make(se3.rotation_exp(np.array([0.0, 0.0, yaw])), np.zeros(3))
    frame = take_picture([(tea_box.mesh, T)])
    centre = T[:3, :3] @ tea_box.mesh.centre + T[:3, 3]
    turn = onto_rays(centre[None] / centre[2])[0].T @ T[:3, :3]
    middle = (
        centre
        + onto_rays(centre[None] / centre[2])[0] @ clean_view(tea_box.mesh, tea_box.diameter_m, turn).middle_m
    )
    span_px = SPAN * tea_box.diameter_m / middle[2] * frame.camera.fx
    place = frame.camera.project(middle)[None], middle[2:], np.array([span_px])
    window = codes_of_windows(*window_images(Pyramid(frame.color), frame.depth, *place, tea_box.diameter_m))
    best = np.argsort(-(codes @ window[0]))[:3]
    looks = np.stack([icosphere.look_at(d) for d in icosphere.directions(1)])
    angles = []
    for k in best:
        roll = se3.rotation_exp(np.array([0.0, 0.0, 2 * np.pi * (k % ROLLS) / ROLLS]))
        cosine = (np.trace(turn.T @ roll @ looks[k // ROLLS]) - 1) / 2
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    assert min(angles) < 25.0


def test_codes_are_of_unit_length(codes: Float32) -> None:
    assert codes.shape == (504, 16 * 8 * 8)
    assert np.linalg.norm(codes, axis=1) == pytest.approx(1.0, abs=1e-5)
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 256, (3, SIDE, SIDE, 3)).astype(np.uint8)
    flat = codes_of_windows(colors, np.zeros((3, SIDE, SIDE), np.float32))
    assert np.linalg.norm(flat, axis=1) == pytest.approx(1.0, abs=1e-5)
    assert len(codes_of_windows(colors[:0], np.zeros((0, SIDE, SIDE), np.float32))) == 0


def test_the_network_file_matches_its_record() -> None:
    record = json.loads((WEIGHTS / "views.json").read_text())
    assert hashlib.sha256((WEIGHTS / "views.onnx").read_bytes()).hexdigest() == record["sha256"]
