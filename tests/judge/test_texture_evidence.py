"""Pairs that contradict a texture, and pairs that agree. A pair that contradicts outweighs no other pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.pairs import PairImage
from huepose.judge.region import Region
from huepose.judge.texture_evidence import agreement_many, contrast_disagreement
from huepose.model.types import ReferenceModel
from huepose.paper.extended.pair_score import pair_score_many
from tests.conftest import TakePicture
from tests.judge.regions import seen_by_pairs
from tests.meshes import demo_objects


def _disagreement(model: ReferenceModel, frame: RgbdFrame, T: np.ndarray) -> float:
    return contrast_disagreement(model, *seen_by_pairs(model, frame, T), T)


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.9, 0.6, 0.4), (0.35, 0.3, 0.3)])
def test_hardly_any_contrast_of_the_same_texture_disagrees_in_any_light(
    tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture, light: tuple[float, ...]
) -> None:
    assert _disagreement(tea_box, take_picture([(tea_box.mesh, standing)], light=light), standing) < 0.25


def test_the_outdated_part_of_a_texture_disagrees(
    tea_box: ReferenceModel, standing: np.ndarray, box_frame: RgbdFrame
) -> None:
    right = _disagreement(tea_box, box_frame, standing)
    for share in (0.3, 0.6, 1.0):
        colors = tea_box.pairs.colors.copy()
        old = np.random.default_rng(0).random(len(colors)) < share
        colors[old, :, 1:] *= -2.0  # opposite hues, twice as strong
        model = replace(tea_box, pairs=replace(tea_box.pairs, colors=colors))
        assert _disagreement(model, box_frame, standing) == pytest.approx(
            right + share * (1.0 - right), abs=0.1
        )


def test_most_contrasts_of_a_look_alike_disagree(
    tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture
) -> None:
    other = demo_objects(1)["tea_box"]
    assert _disagreement(tea_box, take_picture([(other, standing)]), standing) > 0.6


def test_no_contrast_disagrees_if_none_is_visible(
    tea_box: ReferenceModel, standing: np.ndarray, box_frame: RgbdFrame
) -> None:
    view = seen_by_pairs(tea_box, box_frame, standing)
    away = standing.copy()
    away[2, 3] += 1.0
    assert contrast_disagreement(tea_box, *view, away) == 0.0


def out_of_date(model: ReferenceModel, share: float) -> ReferenceModel:
    """The model with `share` of its pairs, here and there, in opposite hues twice as strong."""
    colors = model.pairs.colors.copy()
    old = np.random.default_rng(0).random(len(colors)) < share
    colors[old, :, 1:] *= -2.0
    return replace(model, pairs=replace(model.pairs, colors=colors))


@pytest.fixture(scope="module")
def view(tea_box: ReferenceModel, standing: np.ndarray, box_frame: RgbdFrame) -> tuple[Region, PairImage]:
    return seen_by_pairs(tea_box, box_frame, standing)


def test_the_right_pose_agrees_almost_completely_in_any_light(
    tea_box: ReferenceModel, standing: np.ndarray, take_picture: TakePicture
) -> None:
    for light in ((1.0, 1.0, 1.0), (0.9, 0.6, 0.4)):
        region, image = seen_by_pairs(
            tea_box, take_picture([(tea_box.mesh, standing)], light=light), standing
        )
        turned = standing @ se3.make(se3.rotation_exp([0.0, 0.0, np.pi]), np.zeros(3))
        right, wrong = agreement_many(tea_box, region, image, np.stack([standing, turned]))
        assert 1.2 < right <= 2.0
        assert wrong < right - 0.3


def test_an_outdated_part_of_the_texture_takes_away_no_more_than_its_share(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    old = out_of_date(tea_box, 0.3)
    before, after = (float(agreement_many(m, *view, standing[None])[0]) for m in (tea_box, old))
    assert 0.5 * before < after < 0.95 * before
    # the correlation loses more, as the pairs that disagree also vary most
    terms = [pair_score_many(m, *view, standing[None], 1500, 300)[0] for m in (tea_box, old)]
    colors = [row[2] + 0.6 * row[3] for row in terms]
    assert colors[1] / colors[0] < after / before - 0.1


def test_without_visible_pairs_nothing_agrees(
    tea_box: ReferenceModel, standing: np.ndarray, view: tuple[Region, PairImage]
) -> None:
    away = standing.copy()
    away[2, 3] += 1.0
    assert agreement_many(tea_box, *view, away[None]).tolist() == [0.0]
