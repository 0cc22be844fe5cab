"""Corner normals: smooth over gentle bends and seams of the texture, sharp over creases."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Mesh
from huepose.rendering.render import corner_normals


def folded(angle_deg: float) -> Mesh:
    """Two squares that share an edge along y with doubled vertices, the second bent up by an angle."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    first = [[-1, 0, 0], [0, 0, 0], [0, 1, 0], [-1, 1, 0]]
    second = [[0, 0, 0], [c, 0, s], [c, 1, s], [0, 1, 0]]
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    return Mesh(
        np.array(first + second, np.float32),
        faces,
        np.zeros((4, 3, 2), np.float32),
        np.zeros((1, 1, 3), np.uint8),
    )


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 35.0])
def test_a_gentle_bend_is_smooth_also_over_doubled_vertices(angle_deg: float) -> None:
    normals = corner_normals(folded(angle_deg))
    half = np.radians(angle_deg / 2)
    mean = normals[0, 1] + normals[2, 0]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(mean / np.linalg.norm(mean), [-np.sin(half), 0, np.cos(half)], atol=1e-5)
    np.testing.assert_allclose(normals[1, 2], [0, 0, 1], atol=1e-6)  # away from the fold


@pytest.mark.parametrize("angle_deg", [60.0, 90.0, 150.0])
def test_a_crease_stays_sharp(angle_deg: float) -> None:
    a = np.radians(angle_deg)
    normals = corner_normals(folded(angle_deg))
    np.testing.assert_allclose(normals[:2], np.broadcast_to([0, 0, 1], (2, 3, 3)), atol=1e-6)
    np.testing.assert_allclose(normals[2:], np.broadcast_to([-np.sin(a), 0, np.cos(a)], (2, 3, 3)), atol=1e-5)
