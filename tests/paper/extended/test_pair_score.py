"""The pair score is high for the right texture and does not depend on the light; a search maximises it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.pairs import PairImage, pair_arrays
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.paper.extended.pair_score import judged_on, pair_kernel, pair_score_many, scratch
from huepose.paper.extended.pair_search import search_pairs
from tests.conftest import TakePicture
from tests.judge.regions import pair_score, seen_by_pairs


@pytest.fixture(scope="module")
def view(tea_box: ReferenceModel, standing: np.ndarray, box_frame: RgbdFrame) -> tuple[Region, PairImage]:
    return seen_by_pairs(tea_box, box_frame, standing)


def test_the_right_pose_has_high_colour_correlation(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    score = pair_score(tea_box, *view, standing)
    assert score.visible > 50
    assert score.color > 0.7
    assert score.contrast > 0.6
    assert score.total == pytest.approx(score.geometry + score.color + 0.6 * score.contrast)


def test_the_score_does_not_depend_on_the_light(
    tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture, view: tuple[Region, PairImage]
) -> None:
    white = pair_score(tea_box, *view, standing)
    for light in ((0.9, 0.6, 0.4), (0.45, 0.5, 0.6)):
        region, picture = seen_by_pairs(
            tea_box, take_picture([(tea_box.mesh, standing)], light=light), standing
        )
        score = pair_score(tea_box, region, picture, standing)
        assert score.color == pytest.approx(white.color, abs=0.12)
        assert score.contrast == pytest.approx(white.contrast, abs=0.15)


def test_an_offset_of_all_colours_changes_nothing(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    region, picture = view
    shifted = picture._replace(colors=picture.colors + np.array([5.0, -20.0, 12.0], np.float32))
    a, b = pair_score(tea_box, region, picture, standing), pair_score(tea_box, region, shifted, standing)
    assert b.color == pytest.approx(a.color, abs=1e-3)
    assert b.contrast == pytest.approx(a.contrast, abs=1e-3)


def test_inverted_colours_anticorrelate(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    region, picture = view
    score = pair_score(tea_box, region, picture._replace(colors=-picture.colors), standing)
    assert score.color < -0.7
    assert score.contrast < -0.6


def test_occluded_and_saturated_pairs_are_not_read(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    region, picture = view
    behind = se3.perturb(standing, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    assert pair_score(tea_box, region, picture, behind).visible == 0
    blind = replace(region, crop=replace(region.crop, saturated=np.ones_like(region.crop.saturated)))
    score = pair_score(tea_box, blind, picture, standing)
    assert score.visible == 0
    assert score.color == score.contrast == 0.0
    assert score.geometry > 1.0


def test_scores_of_many_poses_equal_single_scores(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    poses = np.stack([se3.perturb(standing, d) for d in np.diag([0.004] * 3 + [0.05] * 3)])
    table = pair_score_many(tea_box, *view, poses, 600, 300)
    for T, row in zip(poses, table, strict=True):
        assert pair_score(tea_box, *view, T).total == pytest.approx(row[0])


def test_the_search_returns_to_the_right_pose(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    rng = np.random.default_rng(0)
    turns, shifts = rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    turns *= np.radians(7.0) / np.linalg.norm(turns, axis=1, keepdims=True)
    shifts *= 0.005 / np.linalg.norm(shifts, axis=1, keepdims=True)
    starts = np.stack([se3.perturb(standing, np.concatenate(x)) for x in zip(shifts, turns, strict=True)])
    before = pair_score_many(tea_box, *view, starts, 300, 150)[:, 0]
    found, totals = search_pairs(tea_box, *view, starts, (8.0, 4.0, 2.0, 1.0, 0.5))
    assert (totals >= before).all()
    np.testing.assert_allclose(pair_score_many(tea_box, *view, found, 300, 150)[:, 0], totals)
    angles = [np.degrees(se3.rotation_angle(T, standing)) for T in found]
    assert np.median(angles) < 1.5
    assert np.median(np.linalg.norm(found[:, :3, 3] - standing[:3, 3], axis=1)) < 0.002


def test_early_termination_decides_as_the_full_total(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    region, picture = view
    on, room = judged_on(tea_box, region, picture, 300, 150), scratch(150)

    def judged(T: np.ndarray, needed: float) -> float:
        return pair_kernel(T, on, room, needed)

    rng = np.random.default_rng(3)
    shortened = 0
    for size in np.linspace(0.02, 3.0, 40):
        T = se3.perturb(standing, rng.normal(size=6) * ([0.01] * 3 + [0.2] * 3) * size)
        total = judged(T, -np.inf)
        assert judged(T, total - 1e-6) == total  # a better pose is scored in full
        for needed in (total + 1e-6, total + 0.3, total + 1.5):
            answer = judged(T, needed)
            assert total - 1e-8 <= answer <= needed
            shortened += answer != total
    assert shortened > 20


@pytest.mark.parametrize("count", [10, 10_000_000])
def test_kernels_get_arrays_of_the_same_layout_for_any_number_of_pairs(
    tea_box: ReferenceModel, count: int
) -> None:
    arrays = pair_arrays(tea_box.pairs, count)
    assert all(a.flags.c_contiguous for a in arrays if isinstance(a, np.ndarray)), (
        "another layout would compile the kernels again"
    )
