"""The reference database of a box: pairs on its surface, seen by several views, two scales, small enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.colorpair.types import SurfacePairs
from huepose.geometry import se3
from huepose.model.types import ReferenceModel
from huepose.paper.pair_reference import (
    PairView,
    ReferenceConfig,
    build_pair_reference,
    merged,
    reference_cameras,
)
from huepose.rendering.render import render
from huepose.support.errors import InputError


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


def test_two_scales_and_all_tables(tea_box: ReferenceModel) -> None:
    p = tea_box.pairs
    coarse = int(p.parameters["coarse_pairs"])
    assert 200 < coarse < len(p.points)
    assert len(p.points) < 20_000
    assert len(p.triangle_keys) <= 200_000
    assert len(p.ppf_keys) <= 200_000
    assert (np.diff(p.triangle_keys) >= 0).all()
    assert (np.diff(p.ppf_keys) >= 0).all()
    assert p.triangles.max() < len(p.cloud_points)
    assert p.ppf.max() < len(p.cloud_points)
    assert 3 <= len(p.centers) <= 8
    assert p.cloud_classes.max() < len(p.centers)
    assert p.parameters["fine_pixels_per_m"] > p.parameters["coarse_pixels_per_m"]


def test_cameras_see_the_whole_object() -> None:
    diameter = 0.2
    rng = np.random.default_rng(0)
    p = rng.normal(size=(200, 3))
    p *= 0.5 * diameter / np.linalg.norm(p, axis=1, keepdims=True)
    for camera, T in reference_cameras(diameter):
        pixels = camera.project(se3.apply(T, p))
        assert pixels.min() > 0
        assert pixels.max() < camera.width - 1


def test_the_same_views_give_the_same_reference(tea_box: ReferenceModel) -> None:
    config = replace(ReferenceConfig(), level=0)
    centring = se3.make(np.eye(3), -tea_box.mesh.centre)
    views = []
    for camera, T_cam_centred in reference_cameras(tea_box.diameter_m, config):
        T = T_cam_centred @ centring
        r = render([(tea_box.mesh, T)], camera)
        views.append(PairView(r.color, r.depth, camera, T))
    a, b = (build_pair_reference(views, tea_box.diameter_m, config) for _ in range(2))
    np.testing.assert_array_equal(a.points, b.points)
    np.testing.assert_array_equal(a.triangle_keys, b.triangle_keys)
    no_ppf = build_pair_reference(views, tea_box.diameter_m, replace(config, ppf=None))
    assert len(no_ppf.ppf_keys) == 0
    assert len(no_ppf.triangle_keys) > 0


def test_views_are_needed_but_texture_is_not() -> None:
    with pytest.raises(InputError, match="no views"):
        build_pair_reference([], 0.2)
    camera, T = reference_cameras(0.2)[0]
    grey = np.full((camera.height, camera.width, 3), 128, np.uint8)
    depth = np.full((camera.height, camera.width), 0.8, np.float32)
    reference = build_pair_reference([PairView(grey, depth, camera, T)], 0.2)
    assert len(reference.points) == len(reference.triangle_keys) == len(reference.ppf_keys) == 0


def test_the_same_pair_seen_thrice_is_one() -> None:
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
    pairs, owners, seen = merged(every, np.array([0, 1, 1, 2, 2], np.int32), 0.002, 100)
    assert sorted(seen.tolist()) == [1, 1, 3]
    assert seen[0] == 3  # most seen first
    assert len(owners) == len(pairs) == 3
    np.testing.assert_allclose(np.sort(pairs.colors[0, :, 0]), [20.67, 70.67], atol=0.3)
    assert len(merged(every, np.zeros(5, np.int32), 0.002, 2)[0]) == 2
