"""Texture pyramids: levels, means, what is not used, textures that repeat."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.rendering import render
from huepose.rendering.textures import build_pyramid, covered_texels


def sheet(texture: np.ndarray, uv: np.ndarray) -> Mesh:
    """A square of 1 m facing -z whose corners have the given uv (4, 2)."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) / 2
    faces = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    return Mesh(vertices, faces, uv.astype(np.float32)[faces], texture)


UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


def test_levels_halve_down_to_one_texel_and_keep_the_mean() -> None:
    texture = np.random.default_rng(0).integers(0, 256, (64, 32, 3), dtype=np.uint8)
    pyramid = build_pyramid(sheet(texture, UNIT))
    assert pyramid.levels[:, 1:].tolist() == [[64, 32], [32, 16], [16, 8], [8, 4], [4, 2], [2, 1], [1, 1]]
    assert np.array_equal(pyramid.texels[: 64 * 32].reshape(64, 32, 3), texture)
    last = pyramid.texels[pyramid.levels[-1, 0]].astype(float)
    np.testing.assert_allclose(last, texture.mean((0, 1)), atol=2.0)


def test_unused_texels_take_the_colour_of_those_near_them() -> None:
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[16:48, 16:48] = (200, 100, 50)
    mesh = sheet(texture, UNIT * 0.46 + 0.27)
    used = covered_texels(mesh)
    assert 28**2 <= used.sum() <= 31**2
    base = build_pyramid(mesh).texels[: 64 * 64].reshape(64, 64, 3)
    assert np.array_equal(base[used > 0], texture[used > 0])
    assert (base == (200, 100, 50)).all()


def test_a_face_on_a_single_point_of_a_palette_keeps_its_colour() -> None:
    """The palette's other colours are far larger, and the point lies between four texels."""
    texture = np.full((64, 64, 3), 255, np.uint8)
    texture[52:60, 30:40] = (200, 50, 40)
    plain = sheet(texture, np.full((4, 2), [0.55, 56 / 64]))
    large = Mesh(
        plain.vertices + np.float32([3, 0, 0]),
        plain.faces,
        UNIT.astype(np.float32)[plain.faces] * 0.4,
        texture,
    )
    both = Mesh(
        np.concatenate([plain.vertices, large.vertices]),
        np.concatenate([plain.faces, large.faces + 4]),
        np.concatenate([plain.uv, large.uv]),
        texture,
    )
    camera = Camera(100.0, 100.0, 49.5, 49.5, 100, 100)
    shown = render([(both, se3.make(np.eye(3), np.array([0, 0, 2.0])))], camera)
    assert (shown.color[40:60, 40:60] == (200, 50, 40)).all()


def test_texture_coordinates_beyond_one_repeat() -> None:
    texture = np.zeros((32, 32, 3), np.uint8)
    texture[:, 16:] = 255
    mesh = sheet(texture, UNIT * (3.0, 1.0))
    assert covered_texels(mesh).all()
    camera = Camera(600.0, 600.0, 149.5, 9.5, 300, 20)
    row = render([(mesh, se3.make(np.eye(3), np.array([0, 0, 2.0])))], camera).color[10, :, 0]
    # Three periods over 300 px: dark for 50 px, bright for 50 px.
    for k in range(6):
        assert (row[50 * k + 8 : 50 * k + 42] == (255 if k % 2 else 0)).all()
