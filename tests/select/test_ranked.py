"""Different poses keep what the judge said of them, whatever order they are put in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.estimation.config import FullPathConfig
from huepose.geometry import RgbdFrame
from huepose.judge.figure_ground import PRIOR_CONTRAST, figure_ground_contrast
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.select.distinct import Ranked, by_figure
from tests.judge.regions import even_region, shifted

WEIGHT = FullPathConfig().figure_weight
RED, GREY = (170, 40, 30), (128, 128, 128)


@pytest.fixture(scope="module")
def even(tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray) -> Region:
    """A box without any texture, red on grey."""
    return even_region(tea_box, take_picture([(tea_box.mesh, standing)]), standing, RED, GREY)


def test_ranked_by_scores_the_totals_stay() -> None:
    poses = np.arange(48, dtype=float).reshape(3, 4, 4)
    found = Ranked.of(poses, np.array([1.0, 3.0, 2.0]), np.array([0.5, 0.2, 0.9]))
    assert np.array_equal(found.poses, poses[[2, 0, 1]])
    assert found.totals.tolist() == [2.0, 1.0, 3.0]
    assert found.behind == pytest.approx([0.0, 0.4, 0.7])
    assert found.these([0, 2]).totals.tolist() == [2.0, 3.0]


def test_of_poses_that_score_alike_the_one_that_stands_out_comes_first(
    tea_box: ReferenceModel, even: Region, standing: np.ndarray
) -> None:
    poses = np.stack([shifted(standing, 0.03), standing, shifted(standing, -0.05)])
    totals = np.array([1.5, 1.48, 1.5 - WEIGHT * PRIOR_CONTRAST - 0.1])
    out = figure_ground_contrast(tea_box, even, poses)
    found = by_figure(tea_box, even, Ranked.of(poses, totals), WEIGHT)
    assert np.array_equal(found.poses[0], standing)
    assert found.totals.tolist() == [1.48, 1.5, totals[2]]
    assert found.behind[1] == pytest.approx(WEIGHT * (out[1] - out[0]) - 0.02)
    assert (np.diff(found.behind) >= 0).all()


def test_one_that_is_far_ahead_is_not_asked(
    tea_box: ReferenceModel, even: Region, standing: np.ndarray
) -> None:
    poses = np.stack([shifted(standing, 0.03), standing])
    totals = np.array([1.5, 1.5 - WEIGHT * PRIOR_CONTRAST - 0.01])
    found = by_figure(tea_box, even, Ranked.of(poses, totals), WEIGHT)
    assert np.array_equal(found.poses, poses)
    assert np.array_equal(found.totals, totals)
    assert found.behind[1] == pytest.approx(totals[0] - totals[1])
