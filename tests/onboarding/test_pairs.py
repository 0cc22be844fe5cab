"""The colour pairs of a box: on its surface, from several views, at two scales, not too many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.colorpair.types import SurfacePairs
from huepose.model.types import ReferenceModel
from huepose.onboarding.pairs import (
    COARSE,
    DISTANCE,
    FINE,
    Scale,
    coarse_and_fine,
    merged,
    pair_reference,
    reference_camera,
)
from huepose.paper.tables import build_tables, tables_of


def test_pairs_lie_on_the_surface_and_across_it(tea_box: ReferenceModel) -> None:
    p = tea_box.pairs
    low, high = tea_box.mesh.vertices.min(0), tea_box.mesh.vertices.max(0)
    outside = np.maximum(np.maximum(low - p.points, p.points - high), 0).max(1)
    depth = np.minimum(p.points - low, high - p.points).min(1)
    assert (outside < 0.002).all()
    assert (np.abs(depth) < 0.002).mean() > 0.97
    np.testing.assert_allclose(np.linalg.norm(p.tangents, axis=1), 1.0, atol=1e-3)
    assert np.abs((p.tangents * p.normals).sum(1)).max() < 0.02
    # away from the edges of the box, normals are those of its faces
    clear = np.sort(np.minimum(p.points - low, high - p.points), axis=1)[:, 1] > 0.008
    assert (np.abs(p.normals[clear]).max(1) > 0.99).mean() > 0.98


def test_two_scales(tea_box: ReferenceModel) -> None:
    p = tea_box.pairs
    coarse = int(p.parameters["coarse_pairs"])
    assert 200 < coarse < len(p.points)
    assert len(p.points) < 20_000
    assert p.parameters["fine_pixels_per_m"] > p.parameters["coarse_pixels_per_m"]


@pytest.mark.parametrize("scale", [COARSE, FINE])
def test_cameras_see_the_whole_object(scale: Scale) -> None:
    diameter = 0.2
    rng = np.random.default_rng(0)
    p = rng.normal(size=(200, 3))
    p *= 0.5 * diameter / np.linalg.norm(p, axis=1, keepdims=True)
    camera = reference_camera(scale, diameter)
    pixels = camera.project(p + np.array([0.0, 0.0, DISTANCE * diameter]))
    assert pixels.min() > 0
    assert pixels.max() < camera.width - 1


def test_the_same_mesh_gives_the_same_reference(tea_box: ReferenceModel) -> None:
    coarse, fine = coarse_and_fine(tea_box.mesh, tea_box.diameter_m)
    pairs = pair_reference(coarse, fine, tea_box.diameter_m)
    np.testing.assert_array_equal(pairs.points, tea_box.pairs.points)
    np.testing.assert_array_equal(pairs.views, tea_box.pairs.views)
    tables = build_tables(coarse.pairs, coarse.seen, tea_box.diameter_m)
    np.testing.assert_array_equal(tables.triangle_keys, tables_of(tea_box).triangle_keys)


def test_texture_is_not_needed(tea_box: ReferenceModel) -> None:
    grey = replace(tea_box.mesh, texture=np.full_like(tea_box.mesh.texture, 128))
    coarse, fine = coarse_and_fine(grey, 0.2)
    tables = build_tables(coarse.pairs, coarse.seen, 0.2)
    assert len(pair_reference(coarse, fine, 0.2).points) == 0
    assert len(tables.triangle_keys) == len(tables.ppf_keys) == len(tables.cloud_points) == 0


def test_a_pair_seen_in_three_views_is_stored_once() -> None:
    f = np.float32
    one = SurfacePairs(
        np.array([[0, 0, 0]], f),
        np.array([[0, 0, 1]], f),
        np.array([[1, 0, 0]], f),
        np.array([[[20, 0, 0], [70, 0, 0]]], f),
    )
    swapped = SurfacePairs(one.points + f(0.0005), one.normals, -one.tangents, one.colors[:, ::-1] + f(2))
    elsewhere = SurfacePairs(one.points + f(0.05), one.normals, one.tangents, one.colors)
    crossing = SurfacePairs(one.points, one.normals, np.array([[0, 1, 0]], f), one.colors)
    every = SurfacePairs.joined([one, swapped, elsewhere, one, crossing])
    found = merged(every, np.array([0, 1, 1, 2, 2], np.int32), 0.002, 100)
    assert sorted(found.seen.tolist()) == [1, 1, 3]
    assert found.seen[0] == 3  # most seen first
    assert len(found.views) == len(found.pairs) == 3
    np.testing.assert_allclose(np.sort(found.pairs.colors[0, :, 0]), [20.67, 70.67], atol=0.3)
    assert len(merged(every, np.zeros(5, np.int32), 0.002, 2).pairs) == 2
