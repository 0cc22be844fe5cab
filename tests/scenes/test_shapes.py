"""The demo objects: closed, of the stated size, and with a texture that makes no rotation look the same."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, se3
from huepose.rendering import render
from huepose.rendering.render import is_closed
from huepose.rendering.textures import covered_texels
from huepose.scenes.shapes import GAP_PX, demo_objects

OBJECTS = demo_objects(0)


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_are_closed_face_outward_are_centred_and_small(name: str) -> None:
    mesh = OBJECTS[name]
    assert is_closed(mesh.vertices, mesh.faces)
    v = mesh.vertices.astype(np.float64)[mesh.faces]
    assert (v[:, 0] * np.cross(v[:, 1], v[:, 2])).sum() / 6 > 1e-4
    size = np.ptp(mesh.vertices, axis=0)
    assert 0.1 <= size.max() <= 0.2
    assert size.min() >= 0.06
    np.testing.assert_allclose(mesh.centre, 0, atol=1e-6)
    assert 500 < len(mesh.faces) < 8000
    assert (mesh.face_normals()[1] > 0).all()


@pytest.mark.parametrize("name", OBJECTS)
def test_charts_lie_inside_the_texture_and_do_not_overlap(name: str) -> None:
    mesh = OBJECTS[name]
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1
    used = covered_texels(mesh)
    grown = cv2.dilate(used, np.ones((3, 3), np.uint8))
    assert (mesh.texture[grown > 0].max(-1) > 0).all()  # printed a little beyond every edge
    uv = mesh.uv.astype(np.float64) * mesh.texture.shape[0]
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
    assert used.sum() == pytest.approx(flat, rel=0.03)  # no texel is used twice
    assert GAP_PX >= 4


def test_same_seed_same_pixels_other_seed_other_textures() -> None:
    again, other = demo_objects(0), demo_objects(1)
    for name, mesh in OBJECTS.items():
        assert np.array_equal(again[name].texture, mesh.texture)
        assert np.array_equal(again[name].vertices, mesh.vertices)
        assert np.array_equal(other[name].vertices, mesh.vertices)
        changed = np.abs(other[name].texture.astype(int) - mesh.texture).max(-1) > 20
        assert changed[mesh.texture.max(-1) > 0].mean() > 0.5


def view(mesh: Mesh, turn: np.ndarray) -> np.ndarray:
    camera = Camera(500, 500, 79.5, 79.5, 160, 160)
    tilt = se3.rotation_exp(np.array([-1.9, 0, 0]))
    return render([(mesh, se3.make(tilt @ turn, np.array([0, 0, 0.5])))], camera).color.astype(int)


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("angle_deg", [90, 180, 270])
def test_the_texture_distinguishes_rotations_about_the_vertical(name: str, angle_deg: int) -> None:
    mesh = OBJECTS[name]
    turn = se3.rotation_exp(np.array([0, 0, np.radians(angle_deg)]))
    one, two = view(mesh, np.eye(3)), view(mesh, turn)
    both = (one.max(-1) > 0) & (two.max(-1) > 0)
    assert both.sum() > 1500
    assert (np.abs(one - two).max(-1)[both] > 40).mean() > 0.3


def test_a_can_upside_down_does_not_look_the_same() -> None:
    mesh = OBJECTS["soup_can"]
    flipped = view(mesh, se3.rotation_exp(np.array([np.pi, 0, 0])))
    one = view(mesh, np.eye(3))
    both = (one.max(-1) > 0) & (flipped.max(-1) > 0)
    assert (np.abs(one - flipped).max(-1)[both] > 40).mean() > 0.3
