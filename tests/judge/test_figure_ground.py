"""Figure and ground: where a pose has the object, its colours differ from what is round it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.figure_ground import PRIOR_CONTRAST, figure_and_ground, figure_ground_contrast
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from tests.judge.regions import even_region, shifted

RED, GREY = (150, 40, 30), (90, 95, 90)


@pytest.fixture(scope="module")
def even(tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray) -> Region:
    """A box without any texture, red on grey."""
    return even_region(tea_box, take_picture([(tea_box.mesh, standing)]), standing, RED, GREY)


def test_an_even_object_stands_out_where_it_is(
    tea_box: ReferenceModel, even: Region, standing: np.ndarray
) -> None:
    right, aside = figure_ground_contrast(tea_box, even, np.stack([standing, shifted(standing, 0.03)]))
    assert right > 0.9
    assert aside < right - 0.2


def test_what_has_the_colour_of_its_ground_does_not_stand_out(
    tea_box: ReferenceModel, even: Region, standing: np.ndarray
) -> None:
    plain = replace(even, colors=np.zeros_like(even.colors))
    assert figure_ground_contrast(tea_box, plain, standing[None])[0] < 0.05


def test_nothing_is_said_of_a_pose_that_is_not_in_the_picture(tea_box: ReferenceModel, even: Region) -> None:
    away = [se3.make(np.eye(3), np.array(t)) for t in ([0.0, 0.0, -1.0], [9.0, 0.0, 1.0])]
    assert figure_ground_contrast(tea_box, even, np.array(away)).tolist() == [PRIOR_CONTRAST, PRIOR_CONTRAST]


def test_what_stands_in_front_is_neither_figure_nor_ground() -> None:
    rendered = np.zeros((40, 40), np.float32)
    rendered[10:30, 10:30] = 0.5
    observed = np.full((40, 40), 0.8, np.float32)
    observed[10:30, 10:30] = 0.5
    observed[:, 24:] = 0.4  # something hides the right of it
    observed[15:18, 15:18] = 0.0  # a hole in the readings
    figure, ground = figure_and_ground(rendered, observed, 0.01)
    assert figure[10:30, 10:24].all()
    assert not figure[:, 24:].any()
    assert not ground[:, 24:].any()
    assert ground[12:28, 4:9].all()
    assert not ground[:3].any()
    assert not (figure & ground).any()
