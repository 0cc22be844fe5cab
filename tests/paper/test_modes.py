"""A mode is the weighted chordal mean of its votes, whatever the signs of quaternions are."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from huepose.geometry import se3
from huepose.paper.modes import distinct_modes, modes_of


def test_a_mode_is_the_chordal_mean_of_votes_of_any_sign() -> None:
    rng = np.random.default_rng(2)
    turns = [se3.rotation_exp(rng.normal(size=3) * 0.01 + [0.4, -1.9, 0.6]) for _ in range(60)]
    q = np.stack([se3.quaternion_from_rotation(R) for R in turns])
    q *= rng.choice([-1.0, 1.0], (60, 1))
    centres = rng.normal(size=(60, 3)) * 1e-4
    f = np.float32
    weights, features = rng.uniform(0.5, 1.0, 60).astype(f), np.arange(60, dtype=np.int32)
    # a radius so wide that the weights of votes do not change
    scores, means, places = modes_of(q[None].astype(f), centres.astype(f), weights, features, 1e3, 3.0, 30, 5)
    assert len(scores) == 1
    expected = Rotation.from_matrix(np.stack(turns)).mean(weights).as_matrix()
    found = se3.rotation_from_quaternion(means[0])
    angle = np.arccos(np.clip((np.trace(found.T @ expected) - 1) / 2, -1, 1))
    assert angle < 1e-4
    np.testing.assert_allclose(places[0], np.average(centres, axis=0, weights=weights), atol=1e-6)


def test_modes_within_both_limits_are_merged_also_up_to_equivalent_rotations() -> None:
    def quaternion(degrees: float) -> np.ndarray:
        return np.array([0.0, 0.0, np.sin(np.radians(degrees / 2)), np.cos(np.radians(degrees / 2))])

    turned = [0.0, 10.0, 10.0, 90.0, 185.0]
    centres = np.array([[0.0, 0, 0], [0.001, 0, 0], [0.05, 0, 0], [0, 0, 0], [0, 0, 0]])
    alone = np.stack([quaternion(a)[None] for a in turned])
    limits = (np.radians(15.0), 0.01)
    assert distinct_modes(alone, centres, *limits, 10).tolist() == [0, 2, 3, 4]
    half_turns = np.stack([[quaternion(a), quaternion(a + 180.0)] for a in turned])
    assert distinct_modes(half_turns, centres, *limits, 10).tolist() == [0, 2, 3]
    assert distinct_modes(half_turns, centres, *limits, 2).tolist() == [0, 2]
