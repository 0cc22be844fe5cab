"""Visible samples of a curved patch onto a depth image that was made by formula: the pose is recovered."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Camera, se3
from huepose.refine.depth_samples import DepthSamples, add_depth_samples, depth_image
from huepose.refine.solver import Body, advance, clear, normal_equations

CAMERA = Camera(600.0, 600.0, 160.0, 120.0, 320, 240)
RADII = np.array([0.08, 0.05, 0.06])
POSE = se3.make(se3.rotation_exp(np.array([0.2, 0.4, -0.3])), np.array([0.01, -0.01, 0.5]))


def ellipsoid_depth() -> np.ndarray:
    """Depth (240, 320) of an ellipsoid with semi-axes RADII at POSE, exact at pixel centres."""
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u, float)], -1)
    eye, d = se3.inverse(POSE)[:3, 3] / RADII, rays @ POSE[:3, :3] / RADII
    a, b, c = (d * d).sum(-1), (d * eye).sum(-1), eye @ eye - 1.0
    under = b * b - a * c
    return np.where(under > 0, (-b - np.sqrt(np.maximum(under, 0))) / a, 0.0).astype(np.float32)


def front_samples() -> tuple[np.ndarray, np.ndarray]:
    directions = np.random.default_rng(1).normal(size=(900, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points, normals = directions * RADII, directions / RADII
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = ((points - se3.inverse(POSE)[:3, 3]) * normals).sum(1) < -0.25  # at most 60 degrees off the view
    return points[seen].astype(np.float32), normals[seen].astype(np.float32)


def test_a_pose_is_recovered_and_outliers_have_no_say() -> None:
    depth, (points, normals) = ellipsoid_depth(), front_samples()
    depth[100:120, 150:160] -= 0.05  # something in front
    image, body, equations = depth_image(depth, CAMERA), Body(np.zeros(3), 0.06), normal_equations(6)
    T = se3.perturb(POSE, np.array([0.002, -0.002, 0.004, 0.03, -0.02, 0.04]))
    for _ in range(20):
        clear(equations)
        weight = add_depth_samples(T, DepthSamples(points, normals, 2.0), image, body, 0.01, equations)
        advance(T, equations, body, 0.0)
    assert weight > 1.6 * len(points)
    assert np.linalg.norm(T[:3, 3] - POSE[:3, 3]) < 2e-4
    assert se3.rotation_angle(T, POSE) < np.radians(0.4)


def test_samples_off_the_image_or_without_depth_add_nothing() -> None:
    points, normals = front_samples()
    image, body, equations = (
        depth_image(ellipsoid_depth(), CAMERA),
        Body(np.zeros(3), 0.06),
        normal_equations(6),
    )
    behind, aside = POSE.copy(), POSE.copy()
    behind[2, 3] -= 1.0
    aside[0, 3] += 5.0
    for T in (behind, aside):
        assert add_depth_samples(T, DepthSamples(points, normals, 1.0), image, body, 0.01, equations) == 0.0
    assert not equations.A.any()
    assert not equations.b.any()
