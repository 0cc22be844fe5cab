"""Near ties are decided by all that distinguishes the poses, and clear leads are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.judge.region import Region
from huepose.judge.terms import totals as judge
from huepose.model.types import ReferenceModel
from huepose.select import near_ties
from huepose.select.distinct import NONE, Ranked
from huepose.select.near_ties import TERMS, WEIGHTS, WITHIN, contest, decided
from tests.conftest import TakePicture
from tests.judge.regions import region_of

UPSIDE_DOWN = se3.make(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


@pytest.fixture(scope="module")
def region(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> Region:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.9, 0.7, 0.5))
    return region_of(frame, tea_box, standing)


def test_the_right_orientation_wins_though_the_score_preferred_the_other(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    wrong = standing @ UPSIDE_DOWN
    found, _ = decided(tea_box, region, Ranked.of(np.stack([wrong, standing]), np.array([1.95, 1.94])))
    assert se3.rotation_angle(found.poses[0], standing) < np.radians(1.0)
    assert found.behind[0] == 0.0
    assert found.behind[1] > 0.1


def test_totals_stay_those_of_the_judge(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(near_ties, "WITHIN", 3.0)
    poses = np.stack([standing @ UPSIDE_DOWN, standing])
    found, held = decided(tea_box, region, Ranked.of(poses, judge(tea_box, region, poses)))
    assert held is not None
    assert found.totals == pytest.approx(judge(tea_box, region, found.poses))


def test_poses_far_apart_in_score_are_left_as_they_are(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    poses = np.stack([standing, standing @ UPSIDE_DOWN])
    same, held = decided(tea_box, region, Ranked.of(poses, np.array([2.0, 1.0])))
    assert held is None
    assert np.array_equal(same.poses, poses)
    assert same.totals.tolist() == [2.0, 1.0]
    assert len(decided(tea_box, region, NONE)[0]) == 0


def test_a_pose_that_is_not_in_the_near_tie_stays_behind(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    aside = se3.compose(se3.make(np.eye(3), [0.05, 0.0, 0.0]), standing)
    poses = np.stack([standing @ UPSIDE_DOWN, standing, aside])
    totals = np.array([1.95, 1.94, 1.95 - WITHIN - 0.2])
    found, _ = decided(tea_box, region, Ranked.of(poses, totals))
    assert se3.rotation_angle(found.poses[0], standing) < np.radians(1.0)
    k = next(k for k, T in enumerate(found.poses) if np.array_equal(T, aside))
    assert found.behind[k] == pytest.approx(WITHIN + 0.2)
    assert found.totals[k] == totals[2]


def test_the_terms_of_the_close_look_favour_the_right_pose(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    near = Ranked.of(np.stack([standing @ UPSIDE_DOWN, standing]), np.array([1.95, 1.94]))
    held = contest(tea_box, region, near)
    assert held is not None
    wrong, right = held.terms
    better = dict(zip(TERMS, right - wrong, strict=True))
    assert better["dense"] == pytest.approx(-0.01)
    assert min(better[name] for name in ("detail", "broad")) > 0.1
    assert held.weighed() == pytest.approx(held.terms @ list(WEIGHTS.values()))
