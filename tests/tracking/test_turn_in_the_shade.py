"""A tracked pose and its near-symmetric rotation are compared in the light that each implies."""

from __future__ import annotations

import pytest

from huepose.tracking.refined import unmoved
from huepose.tracking.rival import lead
from huepose.tracking.subject import Subject
from tests.conftest import TakePicture
from tests.judge.test_implied_light import in_lamplight
from tests.select.test_shade import ABOUT_Z, RIGHT, brick_with_a_dark_side


@pytest.mark.parametrize("ambient", [0.03, 1.0])
def test_the_right_pose_leads_in_the_shade_and_in_daylight(ambient: float, take_picture: TakePicture) -> None:
    brick = brick_with_a_dark_side()
    surface = Subject.of(brick).surface
    frame = in_lamplight(take_picture([(brick.mesh, RIGHT)]), brick.mesh, RIGHT, ambient)
    first, rival = (unmoved(surface, frame, T, None) for T in (RIGHT, RIGHT @ ABOUT_Z))
    plainly, ahead = first.terms.total - rival.terms.total, lead(surface, first, rival, frame)
    assert ahead == pytest.approx(-lead(surface, rival, first, frame))
    assert (plainly > 0.0) == (ambient == 1.0)
    assert ahead > 0.1
