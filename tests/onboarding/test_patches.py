from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.geometry import Camera, icosphere, se3
from huepose.onboarding.patches import PatchLayout, equal_patches, fitting_patches
from huepose.onboarding.simplify import MAX_TRIANGLES, TARGET, simplified
from huepose.onboarding.winding import outward_sign
from huepose.rendering.render import render
from tests.onboarding import solids


def assert_apart(layout: PatchLayout) -> None:
    owner = np.full((layout.size, layout.size), -1)
    for k, ((x, y), side) in enumerate(zip(layout.corners, layout.sides, strict=True)):
        assert side & (side - 1) == 0  # a power of two at a multiple of itself:
        assert x % side == 0  # halving the texture never mixes patches too early
        assert y % side == 0
        assert (owner[y : y + side, x : x + side] == -1).all()
        owner[y : y + side, x : x + side] = k
    assert layout.size <= 1024


@pytest.mark.parametrize("count", [1, 3, 1000, 20_000])
def test_patches_do_not_overlap(count: int) -> None:
    rng = np.random.default_rng(count)
    vertices = rng.normal(size=(3 * count, 3)) * np.repeat(rng.lognormal(size=count), 3)[:, None]
    faces = np.arange(3 * count).reshape(-1, 3)
    equal = equal_patches(vertices, faces)
    assert equal is not None
    assert_apart(equal)
    fitting = fitting_patches(vertices, faces)
    assert_apart(fitting)
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    order = np.argsort(longest)
    assert (np.diff(fitting.sides[order]) >= 0).all()
    assert fitting.sides.sum() > 0
    assert (fitting.sides.astype(float) ** 2).sum() > 0.2 * min(1024**2, count * 512**2)


def test_neighbours_on_the_surface_are_neighbours_in_the_texture() -> None:
    """Coarser levels of a baked texture keep its colours apart: red above, blue below."""
    ball = solids.sphere(0.05)
    layout = equal_patches(ball.vertices, ball.faces)
    assert layout is not None
    is_up = ball.vertices[ball.faces].mean(1)[:, 2] > 0
    colors = np.where(is_up[:, None], [255.0, 0, 0], [0, 0, 255.0])
    picture = layout.baked(lambda faces, weights: colors[faces])
    used = picture.any(-1)
    coarse = cv2.resize(picture.astype(np.float32), None, fx=1 / 32, fy=1 / 32, interpolation=cv2.INTER_AREA)
    share = cv2.resize(used.astype(np.float32), None, fx=1 / 32, fy=1 / 32, interpolation=cv2.INTER_AREA)
    red = coarse[..., 0][share > 0.5] / 255 / share[share > 0.5]
    assert np.minimum(red, 1 - red).mean() < 0.08


def test_too_many_triangles_have_no_layout() -> None:
    assert equal_patches(np.zeros((3, 3)), np.zeros((1_050_000, 3), np.int32)) is None


def test_dense_meshes_are_simplified_and_keep_their_texture() -> None:
    rng = np.random.default_rng(0)
    texture = np.kron(rng.integers(0, 256, (16, 32, 3)), np.ones((16, 16, 1))).astype(np.uint8)
    z = np.linspace(-0.05, 0.05, 120)
    profile = [(0.0, -0.05), *((0.03 + 0.004 * np.sin(60 * h), h) for h in z), (0.0, 0.05)]
    dense = solids.lathe(profile, texture, segments=300)
    assert len(dense.faces) > MAX_TRIANGLES
    lean = simplified(dense)
    assert len(lean.faces) <= TARGET
    assert outward_sign(lean.vertices, lean.faces) == 1
    camera = Camera(900.0, 900.0, 159.5, 159.5, 320, 320)
    for direction in icosphere.directions(0)[::3]:
        T = se3.make(icosphere.look_at(direction), np.array([0.0, 0.0, 0.4]))
        a, b = (render([(m, T)], camera) for m in (dense, lean))
        both = (a.depth > 0) & (b.depth > 0)
        assert ((a.depth > 0) ^ (b.depth > 0)).sum() < 0.02 * both.sum()
        assert np.abs(a.depth - b.depth)[both].mean() < 0.0003
        assert np.abs(a.color.astype(int) - b.color)[both].mean() < 12
        assert np.median(np.abs(a.color.astype(int) - b.color)[both]) <= 2


def test_small_meshes_stay_as_they_are() -> None:
    ball = solids.sphere(0.05)
    assert simplified(ball) is ball
