"""A colour pair on a surface defines a coordinate frame: a single right match gives the whole pose."""

from __future__ import annotations

import numpy as np

from huepose.colorpair.types import SurfacePairs
from huepose.geometry import se3
from huepose.geometry.se3 import angles_to
from huepose.paper.extended.frames import MODEL_PAIRS, frame_votes
from tests.kernels import compiled

T = se3.make(se3.rotation_exp(np.array([0.5, 1.5, -0.8])), np.array([0.1, -0.05, 0.8]))


def random_pairs(count: int, seed: int) -> SurfacePairs:
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t = np.cross(n, rng.normal(size=(count, 3)))
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    colors = np.concatenate([rng.uniform(15, 90, (count, 2, 1)), rng.normal(0, 30, (count, 2, 2))], 2)
    points = rng.uniform(-0.05, 0.05, (count, 3))
    return SurfacePairs(*(x.astype(np.float32) for x in (points, n, t)), colors.astype(np.float32))


def best_votes(scene: SurfacePairs, model: SurfacePairs) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (N, 3, 3) and translations (N, 3) of the vote with the largest weight of each scene pair."""
    votes = frame_votes(scene, model)
    order = np.lexsort((-votes.weights, votes.features))
    first = order[np.unique(votes.features[order], return_index=True)[1]]
    return votes.rotations[first], votes.translations[first]


def test_the_best_match_of_each_pair_is_the_pose() -> None:
    model = random_pairs(60, 0)
    scene = model[np.arange(0, 60, 3)].transformed(T)
    rotations, translations = best_votes(scene, model)
    assert len(rotations) == 20
    np.testing.assert_allclose(angles_to(rotations, T[:3, :3]), 0.0, atol=2e-3)
    np.testing.assert_allclose(translations, np.tile(T[:3, 3], (20, 1)), atol=1e-5)


def test_exchanged_sides_give_the_same_pose() -> None:
    model = random_pairs(30, 1)
    moved = model.transformed(T)
    swapped = SurfacePairs(moved.points, moved.normals, -moved.tangents, moved.colors[:, ::-1].copy())
    rotations, _ = best_votes(swapped, model)
    assert len(rotations) == 30
    np.testing.assert_allclose(angles_to(rotations, T[:3, :3]), 0.0, atol=2e-3)


def test_a_pair_with_many_matches_gives_each_less_weight() -> None:
    model = random_pairs(40, 2)
    model.colors[10:] = model.colors[10]
    votes = frame_votes(model.transformed(T), model)
    per_feature = np.bincount(votes.features, votes.weights)
    assert (per_feature < 1.0 + 1e-5).all()
    rare, common = votes.weights[votes.features < 10], votes.weights[votes.features >= 10]
    assert rare.min() > 5 * common.max()


def test_a_model_of_many_pairs_needs_no_new_compilation() -> None:
    few, many = random_pairs(60, 5), random_pairs(MODEL_PAIRS + 1, 6)
    frame_votes(few, few)
    before = compiled()
    frame_votes(few, many)
    assert compiled() == before


def test_different_colours_do_not_vote() -> None:
    model, scene = random_pairs(5, 3), random_pairs(5, 4)
    model.colors[:] = (20, 40, 30), (60, 40, 30)
    scene.colors[:] = (20, -40, -30), (60, -40, -30)
    assert len(frame_votes(scene, model)) == 0
    assert len(frame_votes(scene, SurfacePairs.empty())) == 0
