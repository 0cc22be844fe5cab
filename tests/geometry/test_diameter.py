"""The largest distance of points is that of all pairs, and takes few of them."""

import time

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from huepose.geometry.diameter import largest_distance


def ball(rng: np.random.Generator, n: int) -> np.ndarray:
    directions = rng.normal(size=(n, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "shape", ["ball", "egg", "dice", "cone", "four balls", "two points", "twice one point"]
)
def test_the_largest_distance_is_that_of_all_pairs_bit_by_bit(shape: str) -> None:
    rng = np.random.default_rng(1)
    points = {
        "ball": ball(rng, 3000),
        "egg": ball(rng, 3000) * (1.0, 0.7, 1.3),
        "dice": rng.uniform(-1, 1, (3000, 3)),
        "cone": np.vstack([ball(rng, 2000) * (1, 1, 0), [[0, 0, 1.6]]]),
        "four balls": np.vstack(
            [ball(rng, 700) * 0.2 + at for at in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
        ),
        "two points": np.array([[0.0, 0, 0], [0, 0, 2]]),
        "twice one point": np.ones((2, 3)),
    }[shape] * 0.05 + rng.normal(size=3)
    assert largest_distance(points) == pdist(points).max()


def test_a_finely_meshed_capsule_takes_no_minutes() -> None:
    """All of its 200,000 vertices are on its hull: 2e10 pairs would take minutes."""
    rng = np.random.default_rng(2)
    half, middle = ball(rng, 100_000) * 0.035, np.array([0, 0, 0.06])
    points = np.vstack([half + middle, half - middle])
    began = time.process_time()
    assert largest_distance(points) == pytest.approx(0.19, rel=1e-4)
    assert time.process_time() - began < 10
