"""Studies on scenes: what they change, and how they count."""

import numpy as np
import pytest

from huepose.scenes.shapes import demo_objects
from huepose.select.near_ties import TERMS
from studies.changed_texture import KINDS, changed, patches
from studies.confusion import best_is_right
from studies.near_ties import Held, fitted


def test_the_share_of_texture_that_is_wanted_is_changed() -> None:
    mesh = demo_objects(0)["tea_box"]
    filled = patches(mesh, 1.0, 0).mean()
    for share in (0.1, 0.3):
        assert patches(mesh, share, 0).mean() / filled == pytest.approx(share, abs=0.04)
    where = patches(mesh, 0.2, 3)
    for kind in KINDS:
        other = changed(mesh, kind, 0.2, 3)
        differs = (other.texture != mesh.texture).any(-1)
        assert not differs[~where].any()
        assert differs[where].mean() > 0.5


def test_a_box_counts_as_known_where_its_own_object_has_the_highest_quality() -> None:
    box = {"scene": "s", "image": 1, "instance": 0, "shown": "can"}
    other = {**box, "instance": 1}
    rows = [
        {**box, "asked": "can", "quality": 0.9}, {**box, "asked": "cup", "quality": 0.2},
        {**other, "asked": "can", "quality": 0.1}, {**other, "asked": "cup", "quality": 0.4},
    ]  # fmt: skip
    assert best_is_right(rows) == 50.0


def test_only_the_term_that_tells_the_right_pose_gets_weight() -> None:
    """Of two contenders the right one is told by the first term alone, with a weight of 2."""
    rng = np.random.default_rng(3)
    contests = []
    for _ in range(2000):
        terms = np.zeros((2, len(TERMS)))
        terms[:, :2] = rng.normal(size=(2, 2))
        odds = 2.0 * (terms[0, 0] - terms[1, 0])
        first = rng.random() < 1.0 / (1.0 + np.exp(-odds))
        contests.append(Held(terms, np.array([first, not first])))
    weights = fitted([contests])
    assert weights[0] == pytest.approx(2.0, rel=0.2)
    assert weights[1] < 0.3
