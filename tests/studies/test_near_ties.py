"""The weights of near ties are found again where they are known."""

import numpy as np
import pytest

from huepose.select.near_ties import TERMS
from studies.near_ties import Held, fitted


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
