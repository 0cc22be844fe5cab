"""Voting: a planted pose among outliers; each feature counts once; equivalent poses are merged."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import se3
from huepose.paper.votes import Votes
from huepose.paper.voting import DISTINCT, DISTINCT_DEG, cluster

DIAMETER = 0.2
CENTRE = np.array([0.01, -0.02, 0.03])


def votes_of(
    poses: np.ndarray, weights: np.ndarray | None = None, features: np.ndarray | None = None
) -> Votes:
    n = len(poses)
    f = np.float32
    return Votes(
        poses[:, :3, :3].astype(f),
        poses[:, :3, 3].astype(f),
        np.ones(n, f) if weights is None else weights.astype(f),
        np.arange(n, dtype=np.int32) if features is None else features.astype(np.int32),
    )


def around(T: np.ndarray, count: int, degrees: float, metres: float, rng: np.random.Generator) -> np.ndarray:
    spread = np.concatenate(
        [rng.normal(0, metres, (count, 3)), np.radians(rng.normal(0, degrees, (count, 3)))], 1
    )
    return np.stack([se3.perturb(T, d) for d in spread])


def anywhere(count: int, rng: np.random.Generator) -> np.ndarray:
    return np.stack(
        [
            se3.make(
                se3.rotation_from_quaternion(rng.normal(size=4)),
                rng.uniform([-0.15, -0.15, 0.5], [0.15, 0.15, 0.8]),
            )
            for _ in range(count)
        ]
    )


@pytest.mark.parametrize("angle", [0.3, 2.0, np.pi])
def test_a_planted_cluster_is_found_among_outliers(angle: float) -> None:
    rng = np.random.default_rng(0)
    axis = np.array([0.6, -0.64, 0.48])
    T = se3.make(se3.rotation_exp(angle * axis), np.array([0.02, 0.05, 0.65]))
    poses = np.concatenate([around(T, 60, 5.0, 0.004, rng), anywhere(2000, rng)])
    found, scores = cluster(votes_of(poses), CENTRE, DIAMETER)
    assert np.degrees(se3.rotation_angle(found[0], T)) < 2.5
    assert np.linalg.norm(se3.apply(found[0], CENTRE) - se3.apply(T, CENTRE)) < 0.003
    assert scores[0] > 2 * scores[1]


def test_a_feature_counts_once() -> None:
    rng = np.random.default_rng(1)
    T_many = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    T_few = se3.make(se3.rotation_exp(np.array([0.0, 2.0, 0.0])), np.array([0.05, 0.0, 0.6]))
    # thirty features vote for one pose, a single feature votes a thousand times for the other
    poses = np.concatenate([around(T_many, 30, 2.0, 0.002, rng), around(T_few, 1000, 2.0, 0.002, rng)])
    features = np.concatenate([np.arange(30), np.full(1000, 30)])
    found, _ = cluster(votes_of(poses, features=features), CENTRE, DIAMETER)
    assert np.degrees(se3.rotation_angle(found[0], T_many)) < 2.0


def test_hypotheses_are_different_and_in_order() -> None:
    rng = np.random.default_rng(2)
    first = se3.make(np.eye(3), np.array([0.0, 0.0, 0.6]))
    second = se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.pi])), np.array([0.0, 0.0, 0.6]))
    poses = np.concatenate([around(first, 50, 4.0, 0.003, rng), around(second, 30, 4.0, 0.003, rng)])
    found, scores = cluster(votes_of(poses), np.zeros(3), DIAMETER)
    assert np.degrees(se3.rotation_angle(found[0], first)) < 3.0
    assert np.degrees(se3.rotation_angle(found[1], second)) < 3.0
    assert (np.diff(scores) <= 0.0).all()
    for i, a in enumerate(found):
        for b in found[:i]:
            turn = np.degrees(se3.rotation_angle(a, b))
            move = np.linalg.norm(a[:3, 3] - b[:3, 3])
            assert turn >= DISTINCT_DEG - 1e-6 or move >= DISTINCT * DIAMETER - 1e-9


def test_the_best_pose_does_not_depend_on_the_order_of_votes() -> None:
    rng = np.random.default_rng(3)
    T = se3.make(se3.rotation_exp(np.array([1.0, 0.5, -0.5])), np.array([0.0, 0.02, 0.7]))
    poses = np.concatenate([around(T, 80, 4.0, 0.003, rng), anywhere(500, rng)])
    a = cluster(votes_of(poses), CENTRE, DIAMETER)[0][0]
    b = cluster(votes_of(poses[rng.permutation(len(poses))]), CENTRE, DIAMETER)[0][0]
    assert np.degrees(se3.rotation_angle(a, b)) < 1.5


def test_no_votes_give_no_hypotheses() -> None:
    assert [len(part) for part in cluster(Votes.empty(), CENTRE, DIAMETER)] == [0, 0]
    joined = Votes.joined([Votes.empty(), votes_of(np.eye(4)[None]), votes_of(np.stack([np.eye(4)] * 2))])
    assert joined.features.tolist() == [0, 1, 2]


def test_equivalent_poses_are_merged() -> None:
    rng = np.random.default_rng(4)
    half_turn = se3.make(se3.rotation_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    equivalents = np.stack([np.eye(4), half_turn])
    T = se3.make(se3.rotation_exp(np.array([0.9, 0.3, -0.2])), np.array([0.0, 0.02, 0.7]))
    # The centre is off the axis of the half turn; the voted position must not be.
    centre = np.array([0.01, 0.0, 0.02])
    equal = np.concatenate([around(T, 25, 4.0, 0.003, rng), around(T @ half_turn, 25, 4.0, 0.003, rng)])
    rival = around(se3.perturb(T, np.array([0, 0, 0, 1.5, 0, 0])), 35, 4.0, 0.003, rng)
    votes = votes_of(np.concatenate([equal, rival]))

    def off(found: np.ndarray) -> float:
        return float(min(np.degrees(se3.rotation_angle(found, T @ turn)) for turn in equivalents))

    together, _ = cluster(votes, centre, DIAMETER, equivalents)
    assert off(together[0]) < 2.0
    # no second hypothesis is an equivalent rotation of the first
    assert all(off(T) > 15.0 for T in together[1:])
    apart, _ = cluster(votes, centre, DIAMETER)
    assert off(apart[0]) > 60.0
