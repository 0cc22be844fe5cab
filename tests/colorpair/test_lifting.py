"""Pairs of an image of a tilted plane lie on that plane, with its normal and a tangent across their edge."""

from __future__ import annotations

import numpy as np

from huepose.colorpair.lifting import lift, local_planes
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry import Camera, se3

CAMERA = Camera(500.0, 510.0, 79.5, 59.5, 160, 120)
NORMAL = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
OFFSET = NORMAL @ np.array([0.0, 0.0, 0.6])


def plane_depth() -> np.ndarray:
    v, u = np.mgrid[0:120, 0:160]
    rays = CAMERA.rays(np.stack([u, v], -1).astype(float))
    return (OFFSET / (rays @ NORMAL)).astype(np.float32)


def pairs_at(pixels: np.ndarray, directions: np.ndarray) -> ColorPairs:
    n = len(pixels)
    return ColorPairs(
        pixels.astype(np.float32),
        directions.astype(np.float32),
        np.full(n, 2.0, np.float32),
        np.zeros((n, 2, 3), np.float32),
    )


def test_lifting_is_exact_on_a_plane() -> None:
    rng = np.random.default_rng(0)
    pixels, directions = rng.uniform(15, 100, (40, 2)), rng.uniform(-np.pi, np.pi, 40)
    everywhere = np.ones((120, 160), bool)
    lifted = lift(pairs_at(pixels, directions), plane_depth(), everywhere, CAMERA)
    assert len(lifted) == 40
    np.testing.assert_allclose(lifted.points @ NORMAL, OFFSET, atol=1e-5)
    np.testing.assert_allclose(CAMERA.project(lifted.points), pixels, atol=1e-3)
    np.testing.assert_allclose(lifted.normals, np.tile(NORMAL, (40, 1)), atol=2e-3)
    np.testing.assert_allclose(lifted.tangents @ NORMAL, 0.0, atol=2e-3)
    # a step along the tangent moves the pixel along the direction
    ahead = CAMERA.project(lifted.points + 1e-4 * lifted.tangents) - CAMERA.project(lifted.points)
    np.testing.assert_allclose(np.arctan2(ahead[:, 1], ahead[:, 0]), directions, atol=0.02)


def test_another_surface_in_the_window_is_gated_out() -> None:
    depth = plane_depth()
    depth[:, 80:] += 0.1
    z, normals, known = local_planes(
        depth, np.ones_like(depth, bool), CAMERA, np.array([[77.0, 60.0]]), 4, 0.012
    )
    assert known[0]
    np.testing.assert_allclose(z[0], plane_depth()[60, 77], atol=1e-4)
    np.testing.assert_allclose(normals[0], NORMAL, atol=5e-3)


def test_noise_is_averaged() -> None:
    rng = np.random.default_rng(1)
    depth = plane_depth() + rng.normal(0, 0.0015, (120, 160)).astype(np.float32)
    pixels = rng.uniform(15, 100, (200, 2))
    z, normals, _ = local_planes(depth, np.ones_like(depth, bool), CAMERA, pixels, 4, 0.012)
    truth = OFFSET / (CAMERA.rays(pixels) @ NORMAL)
    assert (z - truth).std() < 0.0004
    assert np.degrees(np.median(np.arccos(np.clip(normals @ NORMAL, -1, 1)))) < 8.0


def test_nothing_without_depth_or_at_grazing_views() -> None:
    pixels, directions = np.array([[50.0, 50.0]]), np.zeros(1)
    everywhere = np.ones((120, 160), bool)
    nothing = np.zeros((120, 160), np.float32)
    assert not len(lift(pairs_at(pixels, directions), nothing, everywhere, CAMERA))
    outside = np.zeros((120, 160), bool)
    assert not len(lift(pairs_at(pixels, directions), plane_depth(), outside, CAMERA))
    assert not len(lift(pairs_at(pixels, directions), plane_depth(), everywhere, CAMERA, min_facing=0.99))


def test_pairs_move_with_their_frame() -> None:
    rng = np.random.default_rng(2)
    x = rng.normal(size=(3, 5, 3)).astype(np.float32)
    pairs = SurfacePairs(x[0], x[1], x[2], np.zeros((5, 2, 3), np.float32))
    T = se3.make(se3.rotation_exp(np.array([0.2, 0.5, -0.3])), np.array([0.1, 0.2, 0.3]))
    back = pairs.transformed(T).transformed(se3.inverse(T))
    np.testing.assert_allclose(back.points, pairs.points, atol=1e-6)
    np.testing.assert_allclose(back.tangents, pairs.tangents, atol=1e-6)
    assert len(SurfacePairs.joined([pairs, pairs[:2]])) == 7
