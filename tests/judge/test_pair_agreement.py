"""Agreement of pairs: what disagrees wholly counts as nothing, and outweighs nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.pair_agreement import agreement_many
from huepose.judge.pair_kernel import PairPicture
from huepose.judge.pair_terms import pair_score_many
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from tests.judge.regions import seen_by_pairs

TakePicture = Callable[..., RgbdFrame]


def out_of_date(model: ReferenceModel, share: float) -> ReferenceModel:
    """The model with `share` of its pairs, here and there, in opposite hues twice as strong."""
    colors = model.pairs.colors.copy()
    old = np.random.default_rng(0).random(len(colors)) < share
    colors[old, :, 1:] *= -2.0
    return replace(model, pairs=replace(model.pairs, colors=colors))


@pytest.fixture(scope="module")
def view(
    tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture
) -> tuple[Region, PairPicture]:
    return seen_by_pairs(tea_box, take_picture([(tea_box.mesh, standing)]), standing)


def test_the_right_pose_agrees_nearly_wholly_in_any_light(
    tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture
) -> None:
    for light in ((1.0, 1.0, 1.0), (0.9, 0.6, 0.4)):
        region, picture = seen_by_pairs(
            tea_box, take_picture([(tea_box.mesh, standing)], light=light), standing
        )
        turned = standing @ se3.make(se3.rotation_exp([0.0, 0.0, np.pi]), np.zeros(3))
        right, wrong = agreement_many(tea_box, region, picture, np.stack([standing, turned]))
        assert 1.2 < right <= 2.0
        assert wrong < right - 0.3


def test_what_is_out_of_date_takes_away_its_own_share_and_no_more(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairPicture]
) -> None:
    old = out_of_date(tea_box, 0.3)
    before, after = (float(agreement_many(m, *view, standing[None])[0]) for m in (tea_box, old))
    assert 0.5 * before < after < 0.95 * before
    # the correlation loses more, as what disagrees is also what varies most
    terms = [pair_score_many(m, *view, standing[None], 1500)[0] for m in (tea_box, old)]
    colors = [row[2] + 0.6 * row[3] for row in terms]
    assert colors[1] / colors[0] < after / before - 0.1


def test_without_pairs_in_sight_nothing_agrees(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairPicture]
) -> None:
    away = standing.copy()
    away[2, 3] += 1.0
    assert agreement_many(tea_box, *view, away[None]).tolist() == [0.0]
