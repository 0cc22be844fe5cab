"""Near-symmetric rotations are compared in the light that each implies; other poses are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.judge.region import Region
from huepose.judge.terms import totals
from huepose.model.types import ReferenceModel
from huepose.select.distinct import NONE, Ranked
from huepose.select.near_ties import TERMS, contest
from huepose.select.shade import REACH, in_their_light, rotated
from tests.conftest import TakePicture, standing_pose
from tests.judge.regions import region_of
from tests.judge.test_implied_light import RED, in_lamplight
from tests.onboarded import onboarded
from tests.onboarding import solids

RIGHT = standing_pose(0.6, 0.0, 0.0)
ABOUT_Z = se3.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def brick_with_a_dark_side() -> ReferenceModel:
    """A red brick with a yellow label on each side. One side is dark: it is out of view in the right pose,
    and half a turn brings it where the shade is."""
    side = np.full((64, 64, 3), RED, np.uint8)
    side[20:32, 16:48] = (200, 180, 30)
    return onboarded(
        solids.box((0.06, 0.05, 0.09), {**dict.fromkeys(solids.SIDES, side), "+x": side // 3}),
        "brick",
        searched=False,
    )


@pytest.fixture(scope="module")
def brick() -> ReferenceModel:
    return brick_with_a_dark_side()


@pytest.fixture(scope="module")
def region(brick: ReferenceModel, take_picture: TakePicture) -> Region:
    frame = in_lamplight(take_picture([(brick.mesh, RIGHT)]), brick.mesh, RIGHT, 0.03)
    return region_of(frame, brick, RIGHT)


def judged(model: ReferenceModel, region: Region, *poses: np.ndarray) -> Ranked:
    return Ranked.of(np.stack(poses), totals(model, region, np.stack(poses)))


def test_the_right_pose_wins_though_a_dark_side_looks_like_the_shade(
    brick: ReferenceModel, region: Region
) -> None:
    found = judged(brick, region, RIGHT, RIGHT @ ABOUT_Z)
    assert np.array_equal(found.poses[1], RIGHT)
    assert found.behind[1] > 0.05
    lit, shaded = in_their_light(brick, region, found)
    assert shaded
    assert np.array_equal(lit.poses[0], RIGHT)
    assert lit.behind[1] > 0.1
    assert lit.totals.tolist() == found.totals[::-1].tolist()


def test_in_daylight_the_right_pose_stays(brick: ReferenceModel, take_picture: TakePicture) -> None:
    region = region_of(take_picture([(brick.mesh, RIGHT)]), brick, RIGHT)
    near = Ranked(np.stack([RIGHT, RIGHT @ ABOUT_Z]), np.array([2.1, 2.0]), np.array([0.0, 0.1]))
    lit, _ = in_their_light(brick, region, near)
    assert np.array_equal(lit.poses[0], RIGHT)
    assert lit.behind[1] > 0.0


def test_a_pose_alone_no_rotation_or_far_behind_is_left_as_it_is(
    brick: ReferenceModel, region: Region
) -> None:
    for ranked in (judged(brick, region, RIGHT), NONE):
        assert in_their_light(brick, region, ranked) == (ranked, False)
    aside = se3.compose(se3.make(se3.rotation_exp(np.array([0.0, 0.0, 0.6])), np.zeros(3)), RIGHT)
    turned = RIGHT @ ABOUT_Z
    assert rotated(brick, RIGHT, np.stack([turned, aside])).tolist() == [True, False]
    for other, behind in ((aside, 0.05), (RIGHT, REACH + 0.01)):
        poses = np.stack([turned if other is RIGHT else RIGHT, other])
        found = Ranked(poses, np.array([2.0, 2.0 - behind]), np.array([0.0, behind]))
        assert in_their_light(brick, region, found) == (found, False)


def test_textures_agree_better_in_the_right_light(brick: ReferenceModel, region: Region) -> None:
    found = judged(brick, region, RIGHT, RIGHT @ ABOUT_Z)
    tied = Ranked(found.poses, found.totals, np.zeros(2))
    plain, lit = contest(brick, region, tied), contest(brick, region, tied, shaded=True)
    assert plain is not None
    assert lit is not None
    before, after = (dict(zip(TERMS, held.terms[1] - held.terms[0], strict=True)) for held in (plain, lit))
    for name in ("detail", "broad"):
        assert after[name] > before[name] + 0.1
        assert after[name] > 0.15
