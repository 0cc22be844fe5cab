"""Triangles: keys do not change with a motion; a moved copy of the model is found."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from huepose.geometry import kabsch, se3
from huepose.geometry.se3 import angles_to
from huepose.model.types import PaperTables
from huepose.paper import triangles
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.extended.hypotheses import FACING
from huepose.paper.triangles import (
    ANY_FACING,
    BIN,
    MIN_HEIGHT,
    _fit,
    build_triangles,
    draw_triples,
    pack,
    triangle_votes,
)
from huepose.paper.voting import cluster
from tests.paper.conftest import bare_tables

DIAMETER = 0.156
T = se3.make(se3.rotation_exp(np.array([0.7, -0.4, 1.1])), np.array([0.03, -0.02, 0.65]))


@pytest.fixture(scope="module")
def tables(painted: ClassifiedCloud) -> PaperTables:
    """Tables with more and smaller triangles than those of a model, because the cloud is sparse."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(triangles, "CANDIDATES", 200_000)
        patch.setattr(triangles, "ROWS", 20_000)
        keys, corners = build_triangles(painted, DIAMETER)
    bin_m = {"triangle_bin_m": BIN * DIAMETER}
    return bare_tables(painted, triangle_keys=keys, triangles=corners, parameters=bin_m)


def test_draws_have_three_classes_in_order(painted: ClassifiedCloud) -> None:
    triples = draw_triples(painted, 5000, np.random.default_rng(0))
    classes = painted.classes[triples].astype(int)
    assert len(triples) > 1000
    assert (np.diff(classes, axis=1) > 0).all()


def test_the_table_is_sorted_and_its_triangles_are_large(
    painted: ClassifiedCloud, tables: PaperTables
) -> None:
    keys, triangles = tables.triangle_keys, tables.triangles
    assert len(keys) == len(triangles) > 10_000
    assert (np.diff(keys) >= 0).all()
    p = painted.points[triangles].astype(float)
    sides = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2)
    area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    assert (2 * area / sides.max(1) > MIN_HEIGHT * BIN * DIAMETER * 0.999).all()
    # the kept triangles are larger than random ones
    drawn = painted.points[draw_triples(painted, 20_000, np.random.default_rng(1))].astype(float)
    all_areas = 0.5 * np.linalg.norm(np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0]), axis=1)
    assert area.mean() > all_areas.mean()


def test_keys_depend_on_classes_sides_and_chirality() -> None:
    classes, bins = np.array([[0, 2, 5]]), np.array([[3, 7, 4]])
    key = pack(classes, bins, np.array([True]))
    assert key == pack(classes.copy(), bins.copy(), np.array([True]))
    assert key != pack(classes, bins, np.array([False]))
    assert key != pack(classes, bins[:, ::-1], np.array([True]))


def test_the_closed_form_equals_kabsch() -> None:
    rng = np.random.default_rng(2)
    R, t = np.empty((3, 3)), np.empty(3)
    for _ in range(20):
        p = rng.normal(0, 0.05, (3, 3))
        q = se3.apply(T, p) + rng.normal(0, 0.002, (3, 3))
        _fit(p, q, R, t)
        expected = kabsch.fit(p, q)
        np.testing.assert_allclose(R, expected[:3, :3], atol=1e-6)
        np.testing.assert_allclose(t, expected[:3, 3], atol=1e-6)


@pytest.mark.parametrize(("facing", "least"), [(ANY_FACING, 0.04), (FACING, 0.05)])
def test_a_moved_copy_is_found(
    facing: float,
    least: float,
    painted: ClassifiedCloud,
    tables: PaperTables,
    seen_from: Callable[..., ClassifiedCloud],
) -> None:
    scene = seen_from(painted, T)
    votes = triangle_votes(scene, tables, facing, np.random.default_rng(0))
    right = (angles_to(votes.rotations, T[:3, :3]) < np.radians(8)) & (
        np.linalg.norm(votes.translations - T[:3, 3], axis=1) < 0.012
    )
    assert len(votes) > 500
    assert right.mean() > least
    best = cluster(votes, np.zeros(3), DIAMETER)[0][0]
    assert np.degrees(se3.rotation_angle(best, T)) < 4.0
    assert np.linalg.norm(best[:3, 3] - T[:3, 3]) < 0.005


def test_a_mirrored_scene_is_not_found(
    painted: ClassifiedCloud, tables: PaperTables, seen_from: Callable[..., ClassifiedCloud]
) -> None:
    scene = seen_from(painted, T)
    flip = np.array([-1, 1, 1], np.float32)
    mirrored = ClassifiedCloud(scene.points * flip, scene.normals * flip, scene.classes, scene.weights)
    real, fake = (
        triangle_votes(seen, tables, ANY_FACING, np.random.default_rng(0)) for seen in (scene, mirrored)
    )
    real_scores, fake_scores = (cluster(votes, np.zeros(3), DIAMETER)[1] for votes in (real, fake))
    assert fake_scores.max(initial=0.0) < 0.5 * real_scores[0]


def test_the_papers_method_ignores_wrong_normals(
    painted: ClassifiedCloud, tables: PaperTables, seen_from: Callable[..., ClassifiedCloud]
) -> None:
    """It uses normals for the chirality only; the method `colorpair` also compares them."""
    scene = seen_from(painted, T)
    towards = -scene.points / np.linalg.norm(scene.points, axis=1, keepdims=True)
    blind = ClassifiedCloud(scene.points, towards, scene.classes, scene.weights)
    right = []
    for facing in (ANY_FACING, FACING):
        votes = triangle_votes(blind, tables, facing, np.random.default_rng(0))
        near = angles_to(votes.rotations, T[:3, :3]) < np.radians(8)
        near &= np.linalg.norm(votes.translations - T[:3, 3], axis=1) < 0.012
        right.append(int(near.sum()))
    assert right[0] > 80
    assert right[1] < right[0] / 4


def test_two_classes_have_no_triangles(painted: ClassifiedCloud) -> None:
    two = painted[painted.classes < 2]
    assert len(build_triangles(two, DIAMETER)[0]) == 0
    votes = triangle_votes(two, bare_tables(two), ANY_FACING, np.random.default_rng(0))
    assert len(votes) == 0
