"""The box that an object's silhouette fills, the compiled bounds against the plain projection; and the
pixels of an image that an instance takes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import Box, RgbdFrame, se3
from huepose.judge.region import tolerance_m
from huepose.judge.silhouette import projected_box, taken_by
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


def test_the_pixels_that_an_instance_takes_do_not_depend_on_its_origin(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    """The tolerance of depth follows the distance of the object, not that of an origin behind it."""
    off = np.array([0.0, 0.0, 2.0]) @ standing[:3, :3]
    mesh, surface = tea_box.mesh, tea_box.surface
    far = replace(
        tea_box,
        mesh=replace(mesh, vertices=(mesh.vertices - off).astype(np.float32), digest=None),
        surface=replace(surface, points=(surface.points - off).astype(np.float32)),
    )
    tolerance = tolerance_m(tea_box.diameter_m, 0.6)
    frame = replace(box_frame, depth=box_frame.depth + np.float32(tolerance + 0.001))
    near, there = (
        taken_by(model, frame, [T])
        for model, T in ((tea_box, standing), (far, standing @ se3.make(np.eye(3), off)))
    )
    assert near.sum() < 200, "the surface is not there"
    assert (near != there).sum() < 20
