"""The final refinement on edges, the covariance of a pose and the size residual, with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.geometry.camera import POINTS_PER_READING
from huepose.geometry.se3 import carrying
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.onboarding.surface import build_grid
from huepose.refine import final
from huepose.refine.final import FLOOR_SIGMA, TEXTURE_SIGMA, covariance, refine_on_edges, scale_residual
from huepose.refine.point_to_plane import Alignment
from huepose.rendering.render import render_depth
from tests.conftest import TakePicture
from tests.judge.regions import region_of

MIDDLE = np.zeros(3)


def test_where_depth_fixes_nothing_the_texture_does() -> None:
    expected = TEXTURE_SIGMA**2 + FLOOR_SIGMA**2
    np.testing.assert_allclose(covariance(fitted(np.zeros((6, 6))), MIDDLE), np.diag(expected), rtol=1e-12)


def test_no_number_of_points_averages_the_floor_away() -> None:
    floor = np.diag(FLOOR_SIGMA**2)
    np.testing.assert_allclose(covariance(fitted(1e15 * np.eye(6)), MIDDLE), floor, rtol=1e-6, atol=1e-15)


def test_four_times_the_points_halve_what_depth_leaves_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(final, "TEXTURE_SIGMA", np.full(6, 1e3))
    monkeypatch.setattr(final, "FLOOR_SIGMA", np.zeros(6))
    few, many = (np.sqrt(np.diag(covariance(fitted(n * np.eye(6)), MIDDLE))) for n in (1e4, 4e4))
    np.testing.assert_allclose(few, 2.0 * many, rtol=1e-6)


def test_the_noise_is_about_the_object_wherever_its_origin_is() -> None:
    known, off = 1e15 * np.eye(6), np.array([0.0, 5.0, 0.0])
    far = covariance(fitted(known), off)
    assert np.sqrt(far[2, 2]) == pytest.approx(5.0 * FLOOR_SIGMA[3], rel=0.01)
    to_object = carrying(off)
    np.testing.assert_allclose(to_object @ far @ to_object.T, np.diag(FLOOR_SIGMA**2), rtol=1e-4, atol=1e-9)


def fitted(information: np.ndarray) -> Alignment:
    """A fit with these normal equations and residuals of a millimetre."""
    return Alignment(np.eye(4), 10, 100, 100.0, 0.001, information)


def test_a_slide_is_undone_and_without_texture_or_mask_the_pose_stays(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.8, 0.7, 0.75))
    mask = render_depth(tea_box.mesh, standing, frame.camera) > 0
    up = standing[:3, :3] @ np.array([0.0, 0.0, 0.002])
    slid = standing.copy()
    slid[:3, 3] += up
    found = refine_on_edges(tea_box, frame, mask, slid)
    assert np.linalg.norm(found[:3, 3] - standing[:3, 3]) < 0.0004
    assert se3.rotation_angle(found, standing) < np.radians(0.3)
    plain = RgbdFrame(np.full_like(frame.color, 120), frame.depth, frame.camera)
    np.testing.assert_array_equal(refine_on_edges(tea_box, plain, mask, slid), slid)
    np.testing.assert_array_equal(refine_on_edges(tea_box, frame, np.zeros_like(mask), slid), slid)


RADIUS_M = 0.06


@pytest.fixture(scope="module")
def region(tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray) -> Region:
    """The region of the tea box."""
    return region_of(box_frame, tea_box, standing)


@pytest.fixture(scope="module")
def ball(tea_box: ReferenceModel) -> ReferenceModel:
    """A ball about the middle of the tea box."""
    normals = np.random.default_rng(0).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = (RADIUS_M * normals + tea_box.mesh.centre).astype(np.float32)
    surface = replace(tea_box.surface, points=points, normals=normals.astype(np.float32))
    return replace(tea_box, surface=surface, grid=build_grid(points, 2 * RADIUS_M), diameter_m=2 * RADIUS_M)


def of_a_ball(ball: ReferenceModel, region: Region, factor: float, distance_m: float) -> float:
    """The scale residual of a ball `factor` times as large as its model, its nearest point in place."""
    T = np.eye(4)
    T[2, 3] = distance_m
    normals = ball.surface.normals.astype(np.float64)
    front = normals[normals[:, 2] < -0.4][:500]
    middle = np.array([0.0, 0.0, (factor - 1.0) * RADIUS_M]) + ball.mesh.centre
    seen = factor * RADIUS_M * front + middle + T[:3, 3]
    return scale_residual(
        ball, replace(region, points_cam=seen, point_weights=np.ones(len(seen)), median_depth_m=distance_m), T
    )


def test_the_size_of_a_ball_is_measured(ball: ReferenceModel, region: Region) -> None:
    assert of_a_ball(ball, region, 1.0, 0.6) == pytest.approx(0.0, abs=0.003)
    larger = of_a_ball(ball, region, 1.1, 0.6)
    assert larger == pytest.approx(np.log(1.1), abs=0.05)
    assert larger > 0.03
    assert of_a_ball(ball, region, 1.0 / 1.1, 0.6) < -0.03


def test_far_away_depth_says_less_about_size(ball: ReferenceModel, region: Region) -> None:
    assert 0.0 < of_a_ball(ball, region, 1.1, 1.5) < 0.5 * of_a_ball(ball, region, 1.1, 0.6)


def test_flat_sides_alone_say_nothing_about_size(
    tea_box: ReferenceModel, region: Region, standing: np.ndarray
) -> None:
    assert scale_residual(tea_box, region, standing) == pytest.approx(0.0, abs=0.01)


def test_compiled_steps_are_those_of_the_formula(
    tea_box: ReferenceModel, region: Region, standing: np.ndarray
) -> None:
    rng, seen = np.random.default_rng(2), []
    for _ in range(10):
        T = se3.perturb(standing, rng.normal(size=6) * ([0.01] * 3 + [0.1] * 3))
        expected = plain(tea_box, region, T)
        seen.append(expected)
        np.testing.assert_allclose(scale_residual(tea_box, region, T), expected, atol=1e-9)
    assert np.ptp(seen) > 0.005


def plain(model: ReferenceModel, region: Region, T: np.ndarray) -> float:
    """Gauss-Newton steps of pose and size on the distances along normals, by arrays; all in object axes."""
    grid, surface, centre = model.grid, model.surface, model.mesh.centre
    gate = max(final.GATE_M, final.SIZE_GATE * model.diameter_m)
    variance = final.size_sigma_m(region.median_depth_m) ** 2 * POINTS_PER_READING
    prior, found = np.diag(1.0 / final.SIZE_PRIOR_SIGMA**2), np.zeros(7)
    for _ in range(final.SIZE_STEPS):
        middle = se3.apply(T, centre)
        points = middle + (region.points_cam - middle) / np.exp(found[6])
        points, camera = se3.apply(se3.inverse(T), points), se3.inverse(T)[:3, 3]
        cell = np.rint((points - grid.origin) / grid.step).astype(int)
        index = grid.nearest[tuple(np.clip(cell, 0, np.array(grid.nearest.shape) - 1).T)]
        normals, gap = surface.normals[index].astype(float), points - surface.points[index]
        share = (gap**2).sum(1) / gate**2
        counts = (share < 1.0) & ((normals * (points - camera)).sum(1) <= 0.0)
        w = np.where(counts, region.point_weights * (1.0 - share) ** 2, 0.0)[:, None] / variance
        arm = points - centre
        J = np.concatenate([normals, np.cross(arm, normals), (normals * arm).sum(1)[:, None]], axis=1)
        step = np.linalg.solve(J.T @ (J * w) + prior, (J * w).T @ (gap * normals).sum(1) - prior @ found)
        found += step
        turn = se3.rotation_exp(step[3:6])
        T = T @ se3.make(turn, centre + turn @ (step[:3] - centre))
    return float(found[6])
