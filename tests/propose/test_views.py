"""Retrieval of views: the true view comes first, whatever the light, also when half of it is occluded,
also when the mask is the whole box."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Box, RgbdFrame, se3
from huepose.judge.region import Crop, prepare_crop
from huepose.model.types import ReferenceModel
from huepose.propose.quick_look import (
    CHANNEL_FLOOR,
    CHANNEL_WEIGHTS,
    DEPTH_WEIGHT,
    FREE_WEIGHT,
    FULL_WEIGHT,
    OVERLAP_WEIGHT,
    RELIEF_SIGMA,
    quick_look,
)
from huepose.propose.templates import TemplateTable, build_table, coarse_views
from huepose.propose.views import _centroid, retrieve
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture


@pytest.fixture(scope="module")
def table(tea_box: ReferenceModel) -> TemplateTable:
    return build_table(tea_box.templates, tea_box.diameter_m)


def whole_image(frame: RgbdFrame, mask: np.ndarray) -> tuple[Crop, np.ndarray]:
    """A crop of the whole image, and the bounds of a mask."""
    box = Box.of_mask(mask) or Box(0, 0, 640, 480)
    return prepare_crop(frame, Box(0, 0, 640, 480)), np.array([box.x, box.y, box.x1, box.y1])


def near(poses: np.ndarray, T: np.ndarray, shift: float = 0.03) -> list[bool]:
    return [
        se3.rotation_angle(P, T) < np.radians(25) and np.linalg.norm(P[:3, 3] - T[:3, 3]) < shift
        for P in poses
    ]


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
        views = retrieve(table, *whole_image(frame, mask), [mask], views=10)
        assert len(views.poses) == 10
        assert (np.diff(views.scores) <= 0).all()
        assert not views.masks.any()
        hits = near(views.poses, T)
        ranks.append(hits.index(True) if any(hits) else 99)
    assert sum(r == 0 for r in ranks) >= 9
    assert max(ranks) < 10


def test_half_a_view_is_enough(
    tea_box: ReferenceModel, table: TemplateTable, take_picture: TakePicture, standing: np.ndarray
) -> None:
    """With its left half occluded, the box is still found where it is."""
    frame = take_picture([(tea_box.mesh, standing)], with_table=False)
    full = render_depth(tea_box.mesh, standing, frame.camera) > 0
    occluded = np.arange(640)[None, :] < np.nonzero(full)[1].mean()
    in_part = RgbdFrame(frame.color, np.where(occluded, np.float32(0.4), frame.depth), frame.camera)
    mask = full & ~occluded
    views = retrieve(table, *whole_image(in_part, mask), [mask], views=10)
    assert any(near(views.poses, standing, 0.04))


def test_the_whole_box_serves_as_a_mask(
    tea_box: ReferenceModel, table: TemplateTable, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    """The mask includes the table. With a wrong mask beside it, the right views still come from the box."""
    truth = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    box = Box.of_mask(truth)
    assert box is not None
    whole, wrong = np.zeros_like(truth), np.zeros_like(truth)
    whole[box.slices(640, 480)] = True
    wrong[400:440, 500:600] = True
    views = retrieve(table, *whole_image(box_frame, truth), [wrong, whole], views=10)
    hits = near(views.poses, standing)
    assert any(hits[:3])
    assert views.masks[hits.index(True)] == 1


def test_views_are_distinct_and_reproducible(
    tea_box: ReferenceModel, table: TemplateTable, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], with_table=False)
    mask = frame.depth > 0
    views = retrieve(table, *whole_image(frame, mask), [mask], views=20)
    for i in range(len(views.poses)):
        assert se3.is_rigid(views.poses[i])
        for k in range(i):
            assert se3.rotation_angle(views.poses[i], views.poses[k]) >= np.radians(17.99)
    assert np.array_equal(views.poses, retrieve(table, *whole_image(frame, mask), [mask], views=20).poses)


def test_an_empty_mask_retrieves_nothing(table: TemplateTable, box_frame: RgbdFrame) -> None:
    empty = np.zeros(box_frame.depth.shape, bool)
    for masks in ([empty], []):
        views = retrieve(table, *whole_image(box_frame, empty), masks, views=5)
        assert views.poses.shape == (0, 4, 4)
        assert views.scores.shape == views.masks.shape == (0,)


@pytest.mark.parametrize(("windows_each", "groups"), [(2, 2), (9, 4), (17, 1)])
def test_the_quick_look_is_that_of_the_plain_sums(
    table: TemplateTable, tea_box: ReferenceModel, windows_each: int, groups: int
) -> None:
    rng = np.random.default_rng(6)
    windows = rng.normal(size=(windows_each * groups, 64, 6)).astype(np.float32)
    windows[..., :4] *= [20.0, 8.0, 8.0, 15.0]
    windows[..., 4:] = rng.uniform(0.0, 1.0, (len(windows), 64, 2))
    which, scores = quick_look(table, windows, windows_each)
    coarse = coarse_views(tea_box.templates)
    some = rng.integers(0, len(table.area), 50)
    relief_mm = RELIEF_SIGMA * table.diameter_m * 1000.0
    for i in some:
        coverage, values_rendered = coarse.coverage[i].astype(float), coarse.values[i].astype(float)
        totals = []
        for window in windows[:, coarse.used].astype(float):
            w, values = window[:, 4], window[:, :4]
            both = max(coverage @ w, 1.0)
            color, weights = 0.0, 2.0
            for c in range(4):
                seen, seen2 = coverage @ (w * values[:, c]) / both, coverage @ (w * values[:, c] ** 2) / both
                first, second = coverage * values_rendered[:, c], coverage * values_rendered[:, c] ** 2
                rendered, rendered2 = first @ w / both, second @ w / both
                cross = first @ (w * values[:, c]) / both
                if c == 3:
                    deviation = max(seen2 + rendered2 - 2.0 * cross - (seen - rendered) ** 2, 0.0)
                    continue
                var_seen, var_rendered = max(seen2 - seen**2, 0.0), max(rendered2 - rendered**2, 0.0)
                weight = CHANNEL_WEIGHTS[c] * np.sqrt(var_rendered)
                color += (
                    weight * (cross - seen * rendered) / (np.sqrt(var_seen * var_rendered) + CHANNEL_FLOOR)
                )
                weights += weight
            area = max(float(table.area[i]), 1.0)
            total = color / weights + OVERLAP_WEIGHT * (coverage @ w) / max(w.sum(), 1.0)
            total += (FULL_WEIGHT * (coverage @ w) - FREE_WEIGHT * (coverage @ window[:, 5])) / area
            totals.append(total + DEPTH_WEIGHT * np.exp(-deviation / (2.0 * relief_mm**2)))
        for group in range(groups):
            ours = totals[windows_each * group : windows_each * (group + 1)]
            np.testing.assert_allclose(scores[group, i], max(ours), atol=1e-3)
            np.testing.assert_allclose(ours[which[group, i]], max(ours), atol=1e-3)


def test_the_middle_of_a_mask_is_the_mean_of_its_pixels() -> None:
    mask = np.random.default_rng(2).random((37, 53)) > 0.7
    rows, columns = np.nonzero(mask)
    np.testing.assert_allclose(_centroid(mask), [columns.mean(), rows.mean()], rtol=1e-14)
