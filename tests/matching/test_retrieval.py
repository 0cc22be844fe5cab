"""Retrieval of views: the true view comes first, whatever the light, also when half of it is hidden."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.matching.retrieval import TemplateTable, build_table, lab_of, retrieve
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth

TakePicture = Callable[..., RgbdFrame]


@pytest.fixture(scope="module")
def table(tea_box: ReferenceModel) -> TemplateTable:
    return build_table(tea_box.templates, tea_box.diameter_m)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    R = se3.rotation_exp(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))
    return se3.make(R, np.array([rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1), rng.uniform(0.6, 1.0)]))


def test_the_true_view_is_among_the_first(
    tea_box: ReferenceModel, table: TemplateTable, take_picture: TakePicture
) -> None:
    rng = np.random.default_rng(2)
    ranks = []
    for _ in range(12):
        T = random_pose(rng)
        frame = take_picture([(tea_box.mesh, T)], light=(0.8, 0.6, 0.45), with_table=False)
        mask = render_depth(tea_box.mesh, T, frame.camera) > 0
        poses, scores = retrieve(table, lab_of(frame.color), frame.depth, mask, frame.camera, 10)
        assert len(poses) == 10
        assert (np.diff(scores) <= 0).all()
        near = [
            se3.rotation_angle(P, T) < np.radians(25) and np.linalg.norm(P[:3, 3] - T[:3, 3]) < 0.03
            for P in poses
        ]
        ranks.append(near.index(True) if any(near) else 99)
    assert sum(r == 0 for r in ranks) >= 8
    assert max(ranks) < 10


def test_half_a_view_is_enough(
    tea_box: ReferenceModel, table: TemplateTable, take_picture: TakePicture, standing: np.ndarray
) -> None:
    """With its left half hidden by something in front, the box is still found where it is."""
    frame = take_picture([(tea_box.mesh, standing)], with_table=False)
    full = render_depth(tea_box.mesh, standing, frame.camera) > 0
    middle = np.nonzero(full)[1].mean()
    hidden = np.arange(640)[None, :] < middle
    depth = np.where(hidden, np.float32(0.4), frame.depth)
    poses, _ = retrieve(table, lab_of(frame.color), depth, full & ~hidden, frame.camera, 10)
    assert any(
        se3.rotation_angle(P, standing) < np.radians(25) and np.linalg.norm(P[:3, 3] - standing[:3, 3]) < 0.04
        for P in poses
    )


def test_views_are_different_and_repeat(
    tea_box: ReferenceModel, table: TemplateTable, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], with_table=False)
    mask = frame.depth > 0
    poses, _ = retrieve(table, lab_of(frame.color), frame.depth, mask, frame.camera, 20)
    for i in range(len(poses)):
        assert se3.is_rigid(poses[i])
        for k in range(i):
            assert se3.rotation_angle(poses[i], poses[k]) >= np.radians(17.99)
    again, _ = retrieve(table, lab_of(frame.color), frame.depth, mask, frame.camera, 20)
    assert np.array_equal(poses, again)


def test_an_empty_mask_retrieves_nothing(
    table: TemplateTable, take_picture: TakePicture, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)])
    poses, scores = retrieve(
        table, lab_of(frame.color), frame.depth, np.zeros(frame.depth.shape, bool), frame.camera, 5
    )
    assert poses.shape == (0, 4, 4)
    assert scores.shape == (0,)
