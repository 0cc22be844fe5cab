"""The unseen family: closed shapes of known size, a third of them with little texture."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, se3
from huepose.rendering import render
from huepose.rendering.render import is_closed
from huepose.rendering.textures import covered_texels
from huepose.scenes import official_sets
from huepose.scenes.rendered import LARGEST_M
from huepose.scenes.shapes import printed
from huepose.scenes.unseen import objects
from huepose.scenes.unseen.objects import SEGMENTS, UnseenObject, arc, loft, unseen_objects
from huepose.scenes.unseen.prints import coat, scheme
from tests.meshes import demo_objects

COUNT = 24

Family = list[UnseenObject]


@pytest.fixture(scope="module")
def family() -> Family:
    return unseen_objects(0)


def volume_m3(mesh: Mesh) -> float:
    v = mesh.vertices.astype(np.float64)[mesh.faces]
    return float((v[:, 0] * np.cross(v[:, 1], v[:, 2])).sum() / 6)


def of(charts: list) -> Mesh:
    rng = np.random.default_rng(0)
    return printed(charts, [coat] * len(charts), scheme(rng), rng, 256)


def test_a_loft_has_the_volume_of_its_shape() -> None:
    """A cylinder, a truncated elliptic cone, a block and half a ring, as polygons of SEGMENTS corners."""
    angle = np.linspace(0, 2 * np.pi, SEGMENTS + 1)

    def ellipse_m2(a: float, b: float) -> float:
        x, y = np.array([np.cos(angle), np.sin(angle)]) / np.hypot(np.cos(angle) / a, np.sin(angle) / b)
        return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)

    cylinder = of(loft([(0, 0, -0.05), (0, 0, 0.05)], [(0.03, 0.03)] * 2))
    assert volume_m3(cylinder) == pytest.approx(ellipse_m2(0.03, 0.03) * 0.1, rel=1e-4)
    cone = of(loft([(0, 0, 0), (0, 0, 0.06)], [(0.04, 0.02), (0.02, 0.01)]))
    assert volume_m3(cone) == pytest.approx(0.06 / 3 * ellipse_m2(0.04, 0.02) * (1 + 0.25 + 0.5), rel=1e-4)
    block = of(loft([(0, 0, 0), (0, 0, 0.06)], [(0.04, 0.02)] * 2, power=60))
    assert volume_m3(block) == pytest.approx(0.08 * 0.04 * 0.06, rel=0.06)
    half = arc((0, 0, 0), (0.05, 0.05), (0, 180))
    ring = of(loft(half, np.full((len(half), 2), 0.01), axis=None, across=(0, 1, 0)))
    assert volume_m3(ring) == pytest.approx(np.pi * 0.05 * np.pi * 0.01**2, rel=0.03)


@pytest.mark.parametrize("number", range(COUNT))
def test_objects_are_closed_face_outward_are_centred_and_textured(family: Family, number: int) -> None:
    mesh = family[number].mesh
    assert is_closed(mesh.vertices, mesh.faces)
    assert volume_m3(mesh) > 5e-5
    size = np.ptp(mesh.vertices, axis=0)
    assert 0.08 < size.max() < min(0.25, LARGEST_M)
    np.testing.assert_allclose((mesh.vertices.min(0) + mesh.vertices.max(0)) / 2, 0, atol=1e-6)
    assert (mesh.texture[covered_texels(mesh) > 0].max(-1) > 0).all()


def contrast(mesh: Mesh) -> float:
    """Mean brightness step (0 to 255) between neighbouring pixels inside the object, over four sides."""
    camera, steps = Camera(600, 600, 79.5, 79.5, 160, 160), []
    for quarter in range(4):
        turn = se3.rotation_exp(np.array([0, 0, quarter * np.pi / 2]))
        upright = se3.rotation_exp(np.array([np.radians(110), 0, 0]))
        seen = render([(mesh, se3.make(upright @ turn, np.array([0, 0, 0.6])))], camera)
        grey, inside = seen.color.astype(float).mean(-1), seen.depth > 0
        both = inside[:, 1:] & inside[:, :-1]
        steps.append(np.abs(np.diff(grey, axis=1))[both].mean())
    return float(np.mean(steps))


def test_a_third_has_little_texture(family: Family) -> None:
    plain = [contrast(obj.mesh) for obj in family if obj.plain]
    textured = [contrast(obj.mesh) for obj in family if not obj.plain]
    assert (len(plain), len(textured)) == (8, 16)
    assert np.median(plain) < 0.4 * np.median(textured)
    assert max(plain) < np.median(textured)


def test_the_family_differs_from_the_demo_and_is_deterministic(
    family: Family, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [obj.name for obj in family]
    assert len(set(names)) == len(names) == COUNT
    assert not set(names) & set(demo_objects(0))
    monkeypatch.setattr(objects, "printed", partial(printed, texture_px=256))  # with larger texels
    first, again, other = unseen_objects(0), unseen_objects(0), unseen_objects(1)
    for a, b, c in zip(first, again, other, strict=True):
        assert np.array_equal(a.mesh.texture, b.mesh.texture)
        assert np.array_equal(a.mesh.vertices, c.mesh.vertices)
        assert not np.array_equal(a.mesh.texture, c.mesh.texture)


def test_ids_differ_from_those_of_ycb(family: Family, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(official_sets, "unseen_objects", lambda seed: family)
    ids = [obj.object_id for obj in official_sets.unseen_set()]
    assert ids == list(range(101, 125))
