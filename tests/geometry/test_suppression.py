"""Of poses close to each other only the best stays."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.suppression import first_different


def _at(x: float, angle: float) -> np.ndarray:
    return se3.make(se3.rotation_exp(np.array([0.0, 0.0, angle])), np.array([x, 0.0, 1.0]))


def test_different_poses_are_kept_in_order() -> None:
    poses = np.array([_at(0, 0), _at(0.001, 0.01), _at(0, 0.5), _at(0.1, 0), _at(0.1, 0.45), _at(0, 0.49)])
    assert first_different(poses, 0.1, 10, 0.01).tolist() == [0, 2, 3, 4]
    assert first_different(poses, 0.1, 2, 0.01).tolist() == [0, 2]


def test_without_a_shift_poses_differ_by_their_rotation_alone() -> None:
    turns = np.array([_at(10.0 * angle, angle) for angle in (0, 0.2, 0.5, 0.6, 1.5)])
    assert first_different(turns, 0.35, 3).tolist() == [0, 2, 4]
    assert first_different(turns, 0.35, 2).tolist() == [0, 2]
    assert first_different(turns[:0], 0.35, 3).tolist() == []


def test_the_shift_is_that_of_the_centre() -> None:
    poses = np.array([_at(0.0, 0.0), _at(0.0, 0.05)])
    assert first_different(poses, 0.1, 2, 0.01).tolist() == [0]
    assert first_different(poses, 0.1, 2, 0.01, np.array([1.0, 0.0, 0.0])).tolist() == [0, 1]
