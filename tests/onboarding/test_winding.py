from __future__ import annotations

import numpy as np

from huepose.onboarding.winding import outward_sign
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
