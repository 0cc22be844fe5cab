from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from huepose.geometry import Mesh
from huepose.geometry.arrays import Float, Int
from huepose.onboarding.winding import facing_inwards, outward_sign
from tests.onboarding import solids


def test_inverted_closed_meshes_are_detected() -> None:
    for mesh in (solids.box((1, 2, 3)), solids.sphere(1.0), solids.moved(solids.box((1, 1, 1)), (9, 9, 9))):
        assert outward_sign(mesh.vertices, mesh.faces) == 1
        assert outward_sign(mesh.vertices, mesh.faces[:, ::-1]) == -1
        assert outward_sign(mesh.vertices, mesh.faces[1:]) == 0
        mixed = mesh.faces.copy()
        mixed[0] = mixed[0, ::-1]
        assert outward_sign(mesh.vertices, mixed) == 0


def test_solids_that_touch_are_still_closed() -> None:
    pair = solids.joined(solids.box((1, 1, 1)), solids.moved(solids.box((1, 1, 1)), (1, 1, 0)))
    assert outward_sign(pair.vertices, pair.faces) == 1
    assert outward_sign(np.round(pair.vertices, 3), pair.faces[:, ::-1]) == -1


BODY = solids.box((6.0, 6.0, 6.0))
KNOB = solids.moved(solids.box((3.0, 3.0, 3.0)), (0.0, 0.0, 4.5))
CAVITY = solids.box((5.0, 5.0, 5.0))
LOOSE = solids.sphere(1.0)


@pytest.mark.parametrize(
    ("parts", "inverted", "turned"),
    [
        ((BODY, KNOB), (0, 0), (0, 0)),
        ((BODY, KNOB), (0, 1), (0, 1)),
        ((BODY, KNOB), (1, 0), (1, 0)),
        ((BODY, KNOB), (1, 1), (1, 1)),
        ((BODY, CAVITY, KNOB), (0, 1, 1), (0, 0, 1)),
        ((BODY, CAVITY, LOOSE), (0, 1, 1), (0, 0, 1)),
        ((BODY, CAVITY, LOOSE), (1, 0, 0), (1, 1, 0)),
        ((BODY, CAVITY), (0, 0), (0, 0)),
    ],
)
def test_mirrored_parts_of_an_assembly_are_detected_but_not_its_cavities(
    parts: tuple[Mesh, ...], inverted: tuple[int, ...], turned: tuple[int, ...]
) -> None:
    pairs = list(zip(parts, inverted, strict=True))
    faces = [mesh.faces[:, ::-1] if flip else mesh.faces for mesh, flip in pairs]
    whole = solids.joined(
        *(Mesh(mesh.vertices, f, mesh.uv, mesh.texture) for mesh, f in zip(parts, faces, strict=True))
    )
    expected = np.concatenate([np.full(len(f), bool(turn)) for f, turn in zip(faces, turned, strict=True)])
    assert facing_inwards(whole.vertices, whole.faces).tolist() == expected.tolist()
    assert not facing_inwards(whole.vertices, whole.faces[1:]).any()


def test_a_sheet_of_two_sides_has_no_outside() -> None:
    corners = np.array([[0, 0, 9], [1, 0, 9], [1, 1, 9], [0, 1, 9]], np.float32)
    sheet = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]], np.int32)
    vertices = np.concatenate([BODY.vertices, corners])
    for flip in (1, -1):
        faces = np.concatenate([BODY.faces, sheet[:, ::flip] + len(BODY.vertices)])
        assert not facing_inwards(vertices, faces).any()


def test_an_assembly_of_many_parts_with_a_cavity_is_examined_in_time() -> None:
    shell, screw = solids.sphere(1.0), solids.box((0.05, 0.05, 0.05))
    places = [0.15 * (np.array(place) - 2.5) for place in np.ndindex(6, 6, 6)]
    vertices = np.concatenate([shell.vertices, 0.95 * shell.vertices] + [screw.vertices + p for p in places])
    screws = [screw.faces + 2 * len(shell.vertices) + k * len(screw.vertices) for k in range(len(places))]
    faces = np.concatenate([shell.faces, shell.faces[:, ::-1] + len(shell.vertices), *screws])

    def cpu_s(work: Callable[[Float, Int], object]) -> float:
        start = time.process_time()
        work(vertices, faces)
        return time.process_time() - start

    assert not facing_inwards(vertices, faces).any()
    reading_s = min(cpu_s(outward_sign) for _ in range(3))
    assert min(cpu_s(facing_inwards) for _ in range(2)) < 40 * reading_s
