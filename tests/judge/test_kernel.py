"""The compiled score: a search that needs only better totals gets the same decisions for less work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, icosphere, se3
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.kernel_arrays import beside, model_arrays, nearest_view, region_arrays
from huepose.judge.region import Region
from huepose.judge.terms import DEFAULT_WEIGHTS, Terms, score, score_many
from huepose.model.types import ReferenceModel
from tests.judge.regions import region_of


@pytest.fixture(scope="module")
def region(tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray) -> Region:
    return region_of(box_frame, tea_box, standing)


def test_a_needed_total_decides_as_the_whole_total_does(
    tea_box: ReferenceModel, standing: np.ndarray, region: Region
) -> None:
    model, seen = model_arrays(tea_box), region_arrays(region)
    rng = np.random.default_rng(3)
    poses = [
        se3.perturb(standing, rng.normal(size=6) * ([0.01] * 3 + [0.2] * 3) * size)
        for size in np.linspace(0.02, 3.0, 60)
    ]
    scratch, terms = np.empty((SCRATCH_ROWS, 220)), np.empty(TERMS)

    def judged(T: np.ndarray, needed: float) -> float:
        return score_kernel(T, model, seen, 220, DEFAULT_WEIGHTS, scratch, terms, needed)

    totals = [judged(T, -np.inf) for T in poses]
    shortened = 0
    for T, total in zip(poses, totals, strict=True):
        assert judged(T, total - 1e-6) == total  # a better pose is judged in full
        for needed in (total + 1e-6, total + 0.1, total + 0.5, total + 1.5):
            answer = judged(T, needed)
            assert total - 1e-9 <= answer <= needed
            shortened += answer != total
    assert shortened > len(poses)


def test_coverage_is_that_of_the_plain_formula(
    tea_box: ReferenceModel, standing: np.ndarray, region: Region
) -> None:
    model, seen = model_arrays(tea_box), region_arrays(region)
    rng = np.random.default_rng(4)
    for size in np.linspace(0.0, 5.0, 12):
        T = se3.perturb(standing, rng.normal(size=6) * ([0.01] * 3 + [0.2] * 3) * size)
        points = (seen.points_cam - T[:3, 3]) @ T[:3, :3]
        cell = np.floor((points - model.origin) / model.step + 0.5).astype(int)
        inside = ((cell >= 0) & (cell < model.nearest.shape)).all(1)
        index = model.nearest[tuple(np.where(inside[:, None], cell, 0).T)]
        offset, normals = points - model.points[index], model.normals[index]
        gap = (offset * normals).sum(1)
        near = inside & (abs(gap) < seen.tolerance)
        near &= np.linalg.norm(offset, axis=1) < 3.0 * seen.tolerance
        near &= (normals * (points + T[:3, :3].T @ T[:3, 3])).sum(1) <= 0.0
        weights = seen.point_weights
        expected = (weights * np.where(near, 1.0 - (gap / seen.tolerance) ** 2, 0.0)).sum() / weights.sum()
        got = score_many(tea_box, region, T[None], 50)[0, 2]
        np.testing.assert_allclose(got, expected, atol=1e-6)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_the_view_found_from_neighbour_to_neighbour_is_the_nearest_of_all(
    level: int, tea_box: ReferenceModel
) -> None:
    views = icosphere.directions(level).astype(np.float32)
    model = model_arrays(tea_box)._replace(directions=views, beside=beside(views), centre=np.zeros(3))
    assert model.beside.shape == (len(views), 6 if level > 1 else 0)
    for eye in np.random.default_rng(5).normal(size=(2000, 3)):
        T = se3.make(np.eye(3), -eye)
        alike = views.astype(np.float64) @ eye
        assert alike[nearest_view(T, model)] == pytest.approx(alike.max(), abs=1e-9)


def test_in_a_removed_plane_a_surface_is_neither_visible_nor_a_free_space_violation(
    tea_box: ReferenceModel, standing: np.ndarray, region: Region
) -> None:
    half = np.zeros(region.crop.depth.shape, bool)
    half[:, : int(np.flatnonzero(region.mask.any(0)).mean())] = True

    def judged(depth_there: np.ndarray) -> Terms:
        depth = np.where(half & (region.crop.depth > 0), depth_there, region.crop.depth)
        there = replace(region, crop=replace(region.crop, depth=depth.astype(np.float32)))
        return score(tea_box, there, standing)

    whole, far = judged(region.crop.depth), judged(np.full(half.shape, 9.0))
    plane, behind = judged(-region.crop.depth), judged(-region.crop.depth - 0.05)
    assert whole.through < 0.02
    assert far.through > 0.3
    assert behind.through == far.through
    assert plane.through < 0.05
    assert plane.seen == far.seen < 0.7 * whole.seen
    assert plane.blind > whole.blind + 0.3
    assert far.depth_fit < plane.depth_fit < whole.depth_fit
