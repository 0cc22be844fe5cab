"""Scene pairs get the classes of similar model pairs, with low confidence if two classes are similar."""

from __future__ import annotations

import numpy as np

from huepose.colorpair.types import SurfacePairs
from huepose.paper.classes import classified, classify
from huepose.paper.cloud import nearest_class

INKS = np.array([[85, 2, 5], [30, 5, -30], [45, 55, 35], [80, -5, 70], [25, 0, 0]], np.float32)


def textures(count: int, seed: int, spread: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    which = np.array([rng.choice(5, 2, replace=False) for _ in range(count)])
    return (INKS[which] + rng.normal(0, spread, (count, 2, 3))).astype(np.float32), which


def test_both_sides_of_a_pair_get_their_classes() -> None:
    model, _ = textures(400, 0)
    scene, truth = textures(200, 1)
    classes, confidence = classify(scene, model, nearest_class(model, INKS), 5)
    sure = confidence > 0.3
    assert sure.mean() > 0.8
    assert (classes[sure] == truth[sure]).all(1).mean() > 0.97


def test_confidence_falls_with_ambiguity_and_distance() -> None:
    model, _ = textures(400, 0)
    model_classes = nearest_class(model, INKS)
    clear = np.array([[[85, 2, 5], [45, 55, 35]]], np.float32)
    between = np.array([[[85, 2, 5], [62, 25, 52]]], np.float32)
    strange = np.array([[[50, -60, 60], [50, 60, -60]]], np.float32)
    c = [float(classify(x, model, model_classes, 5)[1][0]) for x in (clear, between, strange)]
    assert c[0] > 0.7
    assert c[1] < 0.6 * c[0]
    assert c[2] < 0.1


def test_the_cloud_has_both_sides_of_confident_pairs() -> None:
    model, _ = textures(400, 0)
    scene, truth = textures(50, 1, spread=0.5)
    scene[25:] = [[50, -60, 60], [50, 60, -60]]
    f = np.float32
    pairs = SurfacePairs(
        np.zeros((50, 3), f),
        np.tile(np.array([0, 0, -1], f), (50, 1)),
        np.tile(np.array([1, 0, 0], f), (50, 1)),
        scene,
    )
    cloud = classified(
        pairs, SurfacePairs(*(np.zeros((400, 3), f),) * 3, model), nearest_class(model, INKS), 5, 0.002
    )
    assert len(cloud) == 50
    assert (cloud.classes == np.concatenate([truth[:25, 0], truth[:25, 1]])).mean() > 0.97
    np.testing.assert_allclose(cloud.points[:, 0], np.repeat([-0.002, 0.002], 25), atol=1e-7)


def test_no_pairs_have_no_classes() -> None:
    classes, confidence = classify(
        np.zeros((0, 2, 3), np.float32), INKS[None, :2], np.zeros((1, 2), np.uint8), 1
    )
    assert classes.shape == (0, 2)
    assert len(confidence) == 0
