from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from huepose.geometry import Mesh
from huepose.model.types import Surface
from huepose.onboarding import visibility
from huepose.onboarding.cloud import averaged_lab, visible_cloud
from huepose.onboarding.surface import build_grid, build_surface, even_order
from huepose.onboarding.visibility import depth_views, seen
from tests.onboarding import solids

RADIUS = 0.05


def surface_of(mesh: Mesh, diameter: float, level: int = 2) -> Surface:
    views = depth_views(mesh, diameter, level)
    return build_surface(visible_cloud(mesh, views), views)


@pytest.fixture(scope="module")
def ball() -> Surface:
    return surface_of(solids.sphere(RADIUS), 2 * RADIUS, level=3)


def test_normals_of_a_ball_are_its_radii(ball: Surface) -> None:
    assert len(ball.points) == 2000
    # Facets lie inside the sphere.
    np.testing.assert_allclose(np.linalg.norm(ball.points, axis=1), RADIUS, rtol=6e-3)
    radii = ball.points / np.linalg.norm(ball.points, axis=1, keepdims=True)
    cosines = np.einsum("nd,nd->n", radii, ball.normals)
    assert cosines.min() > np.cos(np.radians(3.0))


@pytest.mark.parametrize("count", [125, 250, 700, 1000, 2000])
def test_every_prefix_is_evenly_spaced(ball: Surface, count: int) -> None:
    points = ball.points[:count]
    area = 4 * np.pi * RADIUS**2
    hexagonal = np.sqrt(2 * area / (np.sqrt(3) * count))  # the widest possible spacing
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    assert nearest.min() > 0.40 * hexagonal
    assert nearest.mean() > 0.70 * hexagonal
    everywhere = solids.sphere(RADIUS).vertices
    assert cKDTree(points).query(everywhere)[0].max() < 1.0 * hexagonal  # no hole


def test_random_points_are_not_evenly_spaced() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(1000, 3))
    points *= RADIUS / np.linalg.norm(points, axis=1, keepdims=True)
    hexagonal = np.sqrt(2 * 4 * np.pi * RADIUS**2 / (np.sqrt(3) * 1000))
    assert cKDTree(points).query(points, k=2)[0][:, 1].min() < 0.2 * hexagonal


def test_each_side_of_a_thin_sheet_is_evenly_sampled() -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 1, (4000, 2))
    points = np.concatenate([np.c_[xy, np.zeros(4000)], np.c_[xy, np.full(4000, 1e-3)]])
    normals = np.concatenate([np.tile([0, 0, -1.0], (4000, 1)), np.tile([0, 0, 1.0], (4000, 1))])
    order = even_order(points, normals, 2.0, 400)
    below = points[order[order < 4000]]
    assert 180 <= len(below) <= 220
    assert cKDTree(below).query(below, k=2)[0][:, 1].min() > 0.5 * np.sqrt(2 / (np.sqrt(3) * 200))


def test_share_of_a_box_side_is_its_share_of_area() -> None:
    extents = (0.12, 0.08, 0.04)
    surface = surface_of(solids.box(extents), float(np.linalg.norm(extents)))
    area = np.array([0.08 * 0.04, 0.12 * 0.04, 0.12 * 0.08])
    axis = np.abs(surface.normals).argmax(1)
    flat = np.abs(surface.normals).max(1) > 0.999
    for k in range(3):
        np.testing.assert_allclose((axis == k).mean(), area[k] / area.sum(), atol=0.02)
    assert flat.mean() > 0.8  # normals are bent only within 3 mm of an edge
    inner = (np.abs(surface.points) < np.array(extents) / 2 - 0.004).sum(1) == 2
    assert flat[inner].all()


def test_a_ball_shows_the_cap_that_faces_the_camera(ball: Surface) -> None:
    assert len(ball.directions) == 642
    assert ball.offsets[-1] == len(ball.visible)
    for v in (0, 100, 641):
        indices = ball.visible[ball.offsets[v] : ball.offsets[v + 1]]
        assert (np.diff(indices) > 0).all()
        cosines = ball.normals @ ball.directions[v]
        shown = np.zeros(len(cosines), bool)
        shown[indices] = True
        assert shown[cosines > 0.25].all()  # the rest is grazing, or hidden by perspective at six diameters
        assert not shown[cosines < 0.1].any()


def test_surfaces_behind_others_are_occluded() -> None:
    low, high = solids.box((0.1, 0.02, 0.1)), solids.moved(solids.box((0.1, 0.02, 0.1)), (0.0, 0.06, 0.0))
    mesh = solids.joined(low, high)
    views = depth_views(mesh, float(np.linalg.norm([0.1, 0.08, 0.1])))
    gap = np.array([[0.0, 0.01, 0.0], [0.0, 0.05, 0.0]])
    mask = seen(views, gap, np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    along = views.directions @ np.array([0.0, 1.0, 0.0])
    assert not mask[np.abs(along) > 0.6].any()  # face on, the other board is in front
    sideways = (np.abs(along) < 0.35) & (np.abs(along) > 0.15)
    assert mask[sideways & (along > 0), 0].all()
    assert mask[sideways & (along < 0), 1].all()


def test_visibility_in_batches_equals_visibility_of_single_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """In one batch, a large object would block Ctrl-C for seconds."""
    mesh = solids.joined(solids.box((0.1, 0.02, 0.1)), solids.moved(solids.sphere(0.02), (0.0, 0.04, 0.0)))
    views = depth_views(mesh, 0.15)
    points = np.concatenate([mesh.vertices, mesh.vertices * 0.5])
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    sizes = []
    monkeypatch.setattr(
        visibility,
        "_votes",
        lambda v, p, *rest, inner=visibility._votes: sizes.append(len(p)) or inner(v, p, *rest),
    )
    monkeypatch.setattr(visibility, "_AT_ONCE", len(points) // 3)
    counted = visibility.votes(views, points, normals)
    assert max(sizes) <= len(points) // 3
    assert sum(sizes) == len(points)
    assert (counted == seen(views, points, normals).sum(0))[counted == 0].all()
    alone = [visibility.votes(views, p[None], n[None])[0] for p, n in zip(points, normals, strict=True)]
    assert counted.tolist() == alone
    assert 0 < (counted > 0).sum() < len(counted)
    assert counted.max() > 2
    assert visibility.votes(views, points, normals, enough=2).tolist() == np.minimum(counted, 2).tolist()


def test_inner_walls_are_left_out_and_inverted_faces_are_corrected() -> None:
    """A closed solid with all faces inverted, and an open one with every other face inverted."""
    outside, core = solids.box((0.05, 0.05, 0.05)), solids.box((0.02, 0.02, 0.02))
    surface = surface_of(solids.joined(outside, core), 0.05 * np.sqrt(3))
    assert np.abs(surface.points).max(1).min() > 0.0249
    faces, uv = outside.faces.copy(), outside.uv.copy()
    for every, first in ((1, 0), (2, 1)):
        wrong = faces.copy()
        wrong[::every] = wrong[::every, ::-1]
        turned_uv = uv.copy()
        turned_uv[::every] = turned_uv[::every, ::-1]
        mesh = Mesh(outside.vertices, wrong[first:], turned_uv[first:], outside.texture)
        turned = surface_of(mesh, 0.05 * np.sqrt(3))
        assert (np.einsum("nd,nd->n", turned.points, turned.normals) > 0).mean() > (
            0.999 if first == 0 else 0.97
        )


def test_colors_are_lab_averages_of_the_surface() -> None:
    board = np.zeros((64, 64, 3), np.uint8)
    board[:, ::2] = 255  # stripes of half a millimetre
    half = np.zeros((64, 64, 3), np.uint8)
    half[:, 32:] = (255, 0, 0)
    mesh = solids.box((0.032, 0.032, 0.032), {"+x": board, "+z": half})
    views = depth_views(mesh, 0.032 * np.sqrt(3))
    cloud = visible_cloud(mesh, views)
    up, side = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    coarse = averaged_lab(cloud, np.array([[0.016, 0.0, 0.0]]), side, 0.0035)[0]
    np.testing.assert_allclose(coarse, [50, 0, 0], atol=3)
    red, black = [53.24, 80.09, 67.20], [0, 0, 0]
    fine = averaged_lab(cloud, np.array([[0.01, 0, 0.016], [-0.01, 0, 0.016]]), np.repeat(up, 2, 0), 0.001)
    np.testing.assert_allclose(fine, [red, black], atol=0.5)
    edge = averaged_lab(cloud, np.array([[0.0, 0, 0.016]]), up, 0.0035)[0]
    np.testing.assert_allclose(edge, np.array(red) / 2, rtol=0.1)


def test_grid_agrees_with_brute_force(ball: Surface) -> None:
    grid = build_grid(ball.points, 2 * RADIUS)
    assert grid.step == pytest.approx(0.0015)
    assert grid.nearest.dtype == np.int16
    rng = np.random.default_rng(2)
    cells = np.stack([rng.integers(0, n, 500) for n in grid.nearest.shape], 1)
    centres = grid.origin + grid.step * cells
    distance = np.linalg.norm(centres[:, None] - ball.points[None], axis=2)
    found = distance[np.arange(500), grid.nearest[tuple(cells.T)]]
    np.testing.assert_allclose(found, distance.min(1), atol=1e-9)
    reach = grid.origin + grid.step * (np.array(grid.nearest.shape) - 1)
    assert (grid.origin <= ball.points.min(0) - 0.03 + 1e-6).all()
    assert (reach >= ball.points.max(0) + 0.03 - 1e-6).all()


def test_cells_of_large_objects_grow() -> None:
    assert build_grid(np.random.default_rng(0).uniform(0, 0.4, (200, 3)), 1.4).step == pytest.approx(0.02)
