"""The box that an object's silhouette fills: the compiled bounds against the plain projection."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Box, se3
from huepose.judge.silhouette import projected_box
from huepose.model.types import ReferenceModel
from tests.conftest import TakePicture


def test_the_projected_box_is_that_of_the_samples_pixels(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([])
    camera = frame.camera
    rng = np.random.default_rng(1)
    for _ in range(5):
        T = se3.perturb(standing, rng.normal(size=6) * ([0.1] * 3 + [1.0] * 3))
        points = tea_box.surface.points @ T[:3, :3].T + T[:3, 3]
        expected = Box.of_pixels(camera.project(points)).clipped(camera.width, camera.height)
        found = projected_box(tea_box, frame, T)
        assert found is not None
        assert (found.x, found.y, found.w, found.h) == pytest.approx(
            (expected.x, expected.y, expected.w, expected.h), abs=1e-9
        )
    behind = standing.copy()
    behind[2, 3] = -0.5
    assert projected_box(tea_box, frame, behind) is None
