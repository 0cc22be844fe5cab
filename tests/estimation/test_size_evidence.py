"""By how much larger or smaller the depth would have an object, where that is known: a ball, whose curvature
says its size, and the flat sides of a box, which do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation.size_evidence import stretch
from huepose.geometry import Box, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.onboarding.grid import build_grid
from huepose.rendering.render import render_depth
from huepose.verification.region import Region, prepare_region

TakePicture = Callable[..., RgbdFrame]
RADIUS_M = 0.06


@pytest.fixture(scope="module")
def region(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> Region:
    """The tea box as it is seen."""
    frame = take_picture([(tea_box.mesh, standing)])
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    box = Box.of_mask(mask)
    assert box is not None
    found = prepare_region(frame, mask, box, tea_box.diameter_m)
    assert found is not None
    return found


def of_a_ball(tea_box: ReferenceModel, region: Region, factor: float, distance_m: float) -> float:
    """The stretch of a ball `factor` times as large as its model, its nearest point where it should be."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = (RADIUS_M * normals + tea_box.mesh.centre).astype(np.float32)
    surface = replace(tea_box.surface, points=points, normals=normals.astype(np.float32))
    model = replace(tea_box, surface=surface, grid=build_grid(points, 2 * RADIUS_M), diameter_m=2 * RADIUS_M)
    T = np.eye(4)
    T[2, 3] = distance_m
    front = normals[normals[:, 2] < -0.4][:500]
    middle = np.array([0.0, 0.0, (factor - 1.0) * RADIUS_M]) + tea_box.mesh.centre
    seen = factor * RADIUS_M * front + middle + T[:3, 3]
    return stretch(
        model,
        replace(region, points_cam=seen, point_weights=np.ones(len(seen)), median_depth_m=distance_m),
        T,
    )


def test_the_size_of_a_ball_is_seen(tea_box: ReferenceModel, region: Region) -> None:
    assert of_a_ball(tea_box, region, 1.0, 0.6) == pytest.approx(0.0, abs=0.003)
    assert of_a_ball(tea_box, region, 1.1, 0.6) == pytest.approx(np.log(1.1), abs=0.05)
    assert of_a_ball(tea_box, region, 1.1, 0.6) > 0.03
    assert of_a_ball(tea_box, region, 1.0 / 1.1, 0.6) < -0.03


def test_far_away_depth_says_less_of_size(tea_box: ReferenceModel, region: Region) -> None:
    assert 0.0 < of_a_ball(tea_box, region, 1.1, 1.5) < 0.5 * of_a_ball(tea_box, region, 1.1, 0.6)


def test_flat_sides_alone_say_nothing_of_size(
    tea_box: ReferenceModel, region: Region, standing: np.ndarray
) -> None:
    assert stretch(tea_box, region, standing) == pytest.approx(0.0, abs=0.01)
