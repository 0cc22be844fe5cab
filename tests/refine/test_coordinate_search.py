"""The coordinate search climbs: from a nearby pose it finds the truth that depth alone would not."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES, score_many
from huepose.model.types import ReferenceModel
from huepose.refine.coordinate_search import RACE, search
from tests.judge.regions import region_of


@pytest.fixture(scope="module")
def region(tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray) -> Region:
    return region_of(box_frame, tea_box, standing)


def test_search_climbs_to_the_truth(tea_box: ReferenceModel, standing: np.ndarray, region: Region) -> None:
    rng = np.random.default_rng(1)
    offsets = rng.normal(size=(6, 6))
    offsets[:, :3] *= 0.006 / np.linalg.norm(offsets[:, :3], axis=1, keepdims=True)
    offsets[:, 3:] *= np.radians(6) / np.linalg.norm(offsets[:, 3:], axis=1, keepdims=True)
    starts = np.array([se3.perturb(standing, o) for o in offsets])
    found, totals = search(tea_box, region, starts, (4.0, 2.0, 1.0, 0.5), 800)
    before = score_many(tea_box, region, starts, CLOSE_SAMPLES)[:, 0]
    assert (totals > before).all()
    assert np.allclose(totals, score_many(tea_box, region, found, CLOSE_SAMPLES)[:, 0], atol=0.005)
    for T in found:
        assert se3.is_rigid(T)
        assert np.linalg.norm(T[:3, 3] - standing[:3, 3]) < 0.0025
        assert se3.rotation_angle(T, standing) < np.radians(1.8)
    again, _ = search(tea_box, region, starts, (4.0, 2.0, 1.0, 0.5), 800)
    assert np.array_equal(found, again)


def test_a_pose_far_behind_its_rivals_is_left_as_it_is(
    tea_box: ReferenceModel, standing: np.ndarray, region: Region
) -> None:
    near = se3.perturb(standing, np.array([0.004, -0.003, 0.002, 0.05, -0.03, 0.04]))
    upside_down = standing.copy()
    upside_down[:3, 0] *= -1.0
    upside_down[:3, 1] *= -1.0  # half a turn about its own axis shows another texture
    poses = np.stack([near, upside_down])
    alone, alone_totals = search(tea_box, region, poses, (1.0, 0.5), 800)
    raced, raced_totals = search(tea_box, region, poses, (1.0, 0.5), 800, race=RACE)
    assert np.array_equal(raced[0], alone[0])
    assert raced_totals[0] == alone_totals[0]
    assert np.array_equal(raced[1], upside_down)
    assert raced_totals[1] < alone_totals[1]
