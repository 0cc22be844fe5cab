"""A change of the light's colour is distinguished from all other changes of an image."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.judge.relit import relit
from huepose.model.types import ReferenceModel
from tests.conftest import TakePicture, standing_pose

WHITE, WARM = (1.0, 1.0, 1.0), (1.15, 1.0, 0.6)


@pytest.mark.parametrize(
    ("lights", "yaw", "expected"),
    [
        ((WARM, WHITE), 0.0, True),
        ((WHITE, (1.0, 1.0, 0.85)), 0.3, True),
        ((WHITE, (1.0, 1.0, 0.95)), 0.0, False),
        ((WHITE, (0.6, 0.6, 0.6)), 0.0, False),
        ((WHITE, WHITE), 1.5, False),
    ],
)
def test_only_the_colour_of_the_light_counts(
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    lights: tuple[tuple[float, ...], tuple[float, ...]],
    yaw: float,
    expected: bool,
) -> None:
    one, other = (
        take_picture([(tea_box.mesh, standing_pose(turn, 0.0, 0.0))], light).color
        for turn, light in zip((0.0, yaw), lights, strict=True)
    )
    assert relit(one, other) == expected


def test_an_occluder_and_a_dark_image_are_no_change_of_light(take_picture: TakePicture) -> None:
    seen = take_picture([]).color
    occluded = seen.copy()
    occluded[:, :320] = (40, 90, 200)
    assert not relit(seen, occluded)
    assert not relit(seen // 10, (seen // 10 * np.array(WARM)).astype(np.uint8))
    assert not relit(seen, seen[::2, ::2]), "another size is another camera's"
