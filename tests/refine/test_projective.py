"""Image edges correct a pose along its faces, where depth does not; depth samples correct it across them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.colorpair.extract import extract
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry import Camera, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.refine.final import align_edges
from huepose.refine.projective import (
    DepthSamples,
    ImageEdges,
    add_depth_samples,
    depth_image,
    depth_samples,
    image_edges,
    model_edges,
)
from huepose.refine.solver import Body, advance, clear, normal_equations
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture


def fine_pairs(model: ReferenceModel) -> SurfacePairs:
    p, first = model.pairs, int(model.pairs.parameters["coarse_pairs"])
    return SurfacePairs(p.points[first:], p.normals[first:], p.tangents[first:], p.colors[first:])


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (0.9, 0.65, 0.5)])
def test_a_shift_along_the_faces_is_undone_in_any_light(
    light: tuple[float, float, float],
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=light)
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    edges = image_edges(extract(frame.color, mask))
    rng = np.random.default_rng(0)
    for _ in range(4):
        offset = rng.normal(size=6)
        offset[:3] *= 0.003 / np.linalg.norm(offset[:3])
        offset[3:] *= np.radians(2.0) / np.linalg.norm(offset[3:])
        start = se3.perturb(standing, offset)
        found = align_edges(
            model_edges(fine_pairs(tea_box)), tea_box.surface, edges, frame.depth, frame.camera, start
        )
        assert found.matched > 50
        assert np.linalg.norm((found.T_cam_obj - standing)[:3, 3]) < 0.0006
        assert se3.rotation_angle(found.T_cam_obj, standing) < np.radians(0.4)


def test_edges_of_the_other_contrast_hardly_match_and_none_leave_the_pose_alone(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    mask = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    edges = image_edges(extract(box_frame.color, mask))
    inverted = ImageEdges(edges.pixels, edges.directions, -edges.contrasts)
    right, wrong, none = (
        align_edges(
            model_edges(fine_pairs(tea_box)),
            tea_box.surface,
            seen,
            box_frame.depth,
            box_frame.camera,
            standing,
        )
        for seen in (edges, inverted, image_edges(ColorPairs.empty()))
    )
    assert wrong.matched < 0.3 * right.matched  # what does match is the other side of thin lines
    assert none.matched == 0
    np.testing.assert_array_equal(none.T_cam_obj, standing)


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


def test_a_pose_is_recovered_and_outliers_do_not_matter() -> None:
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


@pytest.mark.parametrize(("u", "inside"), [(-0.9, 0.0), (-0.4, 1.0), (319.4, 1.0), (319.9, 0.0)])
def test_a_sample_beside_the_image_is_compared_with_no_pixel_of_it(u: float, inside: float) -> None:
    normal = np.array([[0.0, 0.0, -1.0]], np.float32)
    wall, body = depth_image(np.ones((240, 320), np.float32), CAMERA), Body(np.zeros(3), 0.06)
    for ray in ([u, 120.0, 1.0], [160.0, u - 80.0 * (u > 0.0), 1.0]):
        point = CAMERA.backproject(np.array([ray[:2]]), np.ones(1)).astype(np.float32)
        sample = DepthSamples(point, normal, 1.0)
        assert add_depth_samples(np.eye(4), sample, wall, body, 0.01, normal_equations(6)) == inside


def test_samples_are_those_that_the_camera_sees_wherever_the_origin_is(tea_box: ReferenceModel) -> None:
    surface, T = tea_box.surface, se3.make(se3.rotation_exp(np.array([1.9, 0.3, 0.4])), [0.05, 0.0, 0.6])
    away = np.array([0.3, 0.2, -0.4])
    moved = replace(surface, points=(surface.points + away).astype(np.float32))
    here = depth_samples(surface, T, 500, 1.0)
    there = depth_samples(moved, T @ se3.make(np.eye(3), -away), 500, 1.0)
    np.testing.assert_allclose(there.points - away, here.points, atol=1e-6)
    np.testing.assert_array_equal(there.normals, here.normals)
