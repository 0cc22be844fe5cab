"""Photometric residuals in the solver: colours of a plane undo a slide and a rotation, which depth does
not."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.refine.solver import Body, add_residual, advance, clear, image_row, normal_equations

CAMERA = np.array([600.0, 600.0, 320.0, 240.0])
POSE = se3.make(se3.rotation_exp(np.array([0.3, -0.2, 0.5])), np.array([0.03, -0.02, 0.6]))
BODY = Body(np.zeros(3), 0.05)


def texture(p: np.ndarray) -> np.ndarray:
    """Two channels (N, 2) of a pattern on the plane z = 0 of the object."""
    u, v = p[:, 0] / 0.02, p[:, 1] / 0.02
    return 40.0 * np.stack([np.sin(u) + np.cos(0.7 * v), np.sin(0.6 * u + v)], 1)


def image(pixels: np.ndarray) -> np.ndarray:
    """What a camera sees of that plane at POSE, at pixels (N, 2)."""
    rays = np.concatenate([(pixels - CAMERA[2:]) / CAMERA[:2], np.ones((len(pixels), 1))], 1)
    n, middle = POSE[:3, 2], POSE[:3, 3]
    return texture(se3.apply(se3.inverse(POSE), rays * (n @ middle / (rays @ n))[:, None]))


def test_a_slide_and_a_rotation_in_the_plane_are_undone() -> None:
    grid = np.linspace(-0.04, 0.04, 17)
    points = np.stack([*(g.ravel() for g in np.meshgrid(grid, grid)), np.zeros(289)], 1)
    T = se3.perturb(POSE, np.array([0.003, -0.002, 0.001, 0.01, -0.015, 0.04]))
    equations, h = normal_equations(6), 1e-3
    for _ in range(10):
        cam = se3.apply(T, points)
        pixels = cam[:, :2] / cam[:, 2:] * CAMERA[:2] + CAMERA[2:]
        sides = [(image(pixels + step) - image(pixels - step)) / (2 * h) for step in h * np.eye(2)]
        clear(equations)
        for p, gaps, slopes in zip(points, texture(points) - image(pixels), np.stack(sides, -1), strict=True):
            for gap, slope in zip(gaps, slopes, strict=True):
                add_residual(equations, 1.0, gap, image_row(T, *p, *slope, CAMERA, BODY))
        largest = advance(T, equations, BODY, 0.0)
    assert largest < 1e-7
    np.testing.assert_allclose(T, POSE, atol=1e-6)
