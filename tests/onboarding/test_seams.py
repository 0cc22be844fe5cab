"""A band round a prism; the texture holds its sides in a different order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.onboarding.raw_mesh import Material, RawMesh
from huepose.onboarding.seams import upside_down

SIDES, TEXELS, HEIGHT = 8, 16, 40


def band(prints: str) -> RawMesh:
    """prints: "round" continues from side to side, "apart" has a colour for each side, "plain" one colour."""
    rng = np.random.default_rng(3)
    places = rng.permutation(SIDES)
    texture = rng.integers(0, 256, (HEIGHT, SIDES * TEXELS, 3)).astype(np.uint8)
    if prints != "round":
        texture[HEIGHT // 2 :] = 0
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.stack([np.cos(angles), np.sin(angles)], -1)
    vertices = np.concatenate([np.column_stack([ring, np.full(SIDES, z)]) for z in (0.0, 1.0)])
    faces, uv = [], []
    for k in range(SIDES):
        left, right = places[k] / SIDES, (places[k] + 1.0) / SIDES
        around = (k + np.arange(TEXELS) / TEXELS) * 2.0 * np.pi / SIDES
        picture = 128.0 + 100.0 * np.stack([np.cos(around), np.sin(around), np.cos(2.0 * around)], -1)
        if prints == "apart":
            picture = np.broadcast_to(rng.uniform(0.0, 255.0, 3), picture.shape)
        columns = slice(places[k] * TEXELS, (places[k] + 1) * TEXELS)
        texture[: HEIGHT // 2, columns] = picture if prints != "plain" else 200
        a, b = k, (k + 1) % SIDES
        faces += [[a, b, b + SIDES], [a, b + SIDES, a + SIDES]]
        edge = 1e-4  # within the side's own texels
        low, high = left + edge, right - edge
        uv += [[[low, 0.05], [high, 0.05], [high, 0.45]], [[low, 0.05], [high, 0.45], [low, 0.45]]]
    return RawMesh(
        vertices,
        np.array(faces, np.int32),
        np.array(uv, np.float32),
        None,
        np.zeros(len(faces), np.int32),
        (Material("print", texture=texture),),
    )


def flipped(mesh: RawMesh) -> RawMesh:
    assert mesh.uv is not None
    return replace(mesh, uv=np.float32([0.0, 1.0]) + mesh.uv * np.float32([1.0, -1.0]))


def test_a_texture_that_continues_across_seams_shows_whether_it_is_upside_down():
    assert not upside_down(band("round"))
    assert upside_down(flipped(band("round")))


@pytest.mark.parametrize("prints", ["apart", "plain"])
def test_a_texture_that_does_not_continue_across_seams_is_not_called_upside_down(prints: str):
    assert not upside_down(band(prints))
    assert not upside_down(flipped(band(prints)))


def test_a_mesh_without_a_texture_is_not_called_upside_down():
    mesh = band("round")
    assert not upside_down(replace(mesh, uv=None))
    assert not upside_down(replace(mesh, materials=(Material("grey"),)))
