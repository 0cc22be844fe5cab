"""The renderer against analytic planes, ray casting, and itself."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float32
from huepose.rendering import render, render_depth
from huepose.rendering.raster import rasterise, transform
from huepose.rendering.render import is_closed
from tests.evaluation.conftest import box_mesh

CAMERA = Camera(600.0, 602.5, 312.9869, 241.3109, 640, 480)


def quad(half: float = 0.5, texture: np.ndarray | None = None) -> Mesh:
    """A square in z = 0, side 2 * half, facing -z; texture u along x, v along y."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32) * half
    faces = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    uv = ((vertices[:, :2] / half + 1) / 2)[faces].astype(np.float32)
    if texture is None:
        texture = np.full((4, 4, 3), 200, np.uint8)
    return Mesh(vertices, faces, uv, texture)


def blob(n: int = 40) -> Mesh:
    """A closed bumpy ball of 2 n (n - 1) triangles, about 0.1 m, with a random texture."""
    rng = np.random.default_rng(0)
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, n, endpoint=False), indexing="ij"
    )
    radius = 0.05 + 0.008 * np.sin(3 * phi) * np.sin(theta) ** 2 + 0.004 * np.cos(5 * theta)
    vertices = np.stack(
        [radius * np.sin(theta) * np.cos(phi), radius * np.sin(theta) * np.sin(phi), radius * np.cos(theta)],
        -1,
    )
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n), indexing="ij")
    a, b = i * n + j, i * n + (j + 1) % n
    faces = np.concatenate(
        [np.stack([a, a + n, b], -1).reshape(-1, 3), np.stack([b, a + n, b + n], -1).reshape(-1, 3)]
    )
    uv = np.stack([phi / (2 * np.pi), theta / np.pi], -1).reshape(-1, 2)[faces]
    texture = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    return Mesh(
        vertices.reshape(-1, 3).astype(np.float32), faces.astype(np.int32), uv.astype(np.float32), texture
    )


def rays() -> np.ndarray:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return CAMERA.rays(np.stack([u, v], -1))


def test_tilted_plane_has_its_analytic_depth_and_points() -> None:
    T = se3.make(se3.rotation_exp(np.array([0.7, -0.4, 0.2])), np.array([0.02, -0.01, 0.8]))
    rendered = render([(quad(), T)], CAMERA)
    normal, r = T[:3, 2], rays()
    depth = (normal @ T[:3, 3]) / (r @ normal)
    hit = (r * depth[..., None] - T[:3, 3]) @ T[:3, :3]
    inside = (np.abs(hit[..., :2]) <= 0.5).all(-1) & (depth > 0)
    assert np.array_equal(rendered.depth > 0, inside)
    assert 20_000 < inside.sum() < 300_000
    np.testing.assert_allclose(rendered.depth[inside], depth[inside], rtol=1e-6)
    np.testing.assert_allclose(rendered.points_obj[inside], hit[inside], atol=1e-6)
    np.testing.assert_allclose(
        rendered.normals_cam[inside], np.broadcast_to(-normal, hit.shape)[inside], atol=1e-6
    )
    assert (rendered.points_obj[~inside] == 0).all()


def test_colour_is_the_bilinear_texture_at_the_analytic_uv() -> None:
    ramp = np.zeros((256, 256, 3), np.uint8)
    ramp[..., 0], ramp[..., 1] = np.arange(256)[None], np.arange(256)[:, None]
    T = se3.make(se3.rotation_exp(np.array([0.5, 0.3, 0.0])), np.array([0.0, 0.0, 0.9]))
    rendered = render([(quad(texture=ramp), T)], CAMERA)
    texel = (rendered.points_obj[..., :2] + 0.5) * 256 - 0.5
    middle = (rendered.depth > 0) & ((texel > 3) & (texel < 252)).all(-1)
    assert middle.sum() > 30_000
    error = np.abs(rendered.color[..., :2][middle] - texel[middle])
    assert error.max() <= 0.51


def test_fine_texture_turns_grey_instead_of_aliasing() -> None:
    checker = np.zeros((1024, 1024, 3), np.uint8)
    checker[::2, ::2] = checker[1::2, 1::2] = 255
    rendered = render([(quad(texture=checker), se3.make(np.eye(3), np.array([0, 0, 3.0])))], CAMERA)
    inside = rendered.depth > 0
    assert np.abs(rendered.color[inside].astype(int) - 128).max() <= 4


def test_blank_between_charts_does_not_bleed_into_the_texture() -> None:
    texture = np.zeros((512, 512, 3), np.uint8)
    texture[201:311, 201:311] = (250, 120, 30)
    mesh = quad(texture=texture)
    chart = Mesh(mesh.vertices, mesh.faces, ((mesh.uv * 109 + 201.5) / 512).astype(np.float32), texture)
    rendered = render([(chart, se3.make(np.eye(3), np.array([0, 0, 15.0])))], CAMERA)
    seen = rendered.color[rendered.depth > 0].astype(int)
    assert len(seen) > 500
    assert np.abs(seen - (250, 120, 30)).max() <= 2


def test_agrees_with_ray_casting() -> None:
    o3d = pytest.importorskip("open3d", reason="open3d is not installed")
    mesh = blob(90)
    T = se3.make(se3.rotation_exp(np.array([1.2, 0.4, 0.3])), np.array([0.03, -0.02, 0.5]))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(se3.apply(T, mesh.vertices).astype(np.float32)),
        o3d.core.Tensor(mesh.faces.astype(np.uint32)),
    )
    lines = np.concatenate([np.zeros((480, 640, 3)), rays()], -1).astype(np.float32)
    cast = scene.cast_rays(o3d.core.Tensor(lines))["t_hit"].numpy()
    depth = render_depth(mesh, T, CAMERA)
    both = np.isfinite(cast) & (depth > 0)
    assert both.sum() > 8000
    assert (np.isfinite(cast) ^ (depth > 0)).sum() <= 4
    assert np.median(np.abs(cast - depth)[both]) < 1e-5


def test_points_and_depth_are_the_same_surface() -> None:
    mesh, T = blob(), se3.make(se3.rotation_exp(np.array([0.1, 2.0, 0.3])), np.array([-0.05, 0.03, 0.4]))
    rendered = render([(mesh, T)], CAMERA, color=False)
    seen = rendered.depth > 0
    points_cam = se3.apply(T, rendered.points_obj[seen])
    np.testing.assert_allclose(points_cam[:, 2], rendered.depth[seen], atol=2e-7)
    np.testing.assert_allclose(CAMERA.project(points_cam), np.argwhere(seen)[:, ::-1], atol=2e-4)


def test_smooth_normals_of_a_ball() -> None:
    n = 48
    mesh = blob(n)
    ball = Mesh(
        (0.05 * mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)).astype(np.float32),
        mesh.faces,
        mesh.uv,
        mesh.texture,
    )
    T = se3.make(se3.rotation_exp(np.array([1.0, 0.5, 0.0])), np.array([0, 0, 0.4]))
    rendered = render([(ball, T)], CAMERA)
    seen = rendered.depth > 0
    radial = rendered.points_obj[seen] @ T[:3, :3].T
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    cos = (radial * rendered.normals_cam[seen]).sum(1)
    assert np.median(np.degrees(np.arccos(np.clip(cos, -1, 1)))) < 0.5


@pytest.mark.parametrize("window", [(240, 100, 160, 160), (313, 200, 77, 91), (-20, 300, 400, 250)])
def test_crop_is_the_sub_image(window: tuple[int, int, int, int]) -> None:
    scene = [
        (blob(), se3.make(se3.rotation_exp(np.array([0.3, 0.2, 0.9])), np.array([0.03, 0.02, 0.35]))),
        (quad(), se3.make(se3.rotation_exp(np.array([1.0, 0.1, 0.0])), np.array([0, 0, 0.7]))),
    ]
    x0, y0, width, height = window
    whole = render(scene, CAMERA)
    part = render(scene, CAMERA.cropped(*window))
    rows, columns = slice(max(0, y0), min(480, y0 + height)), slice(max(0, x0), min(640, x0 + width))
    inner = (slice(rows.start - y0, rows.stop - y0), slice(columns.start - x0, columns.stop - x0))
    for name in ("depth", "color", "normals_cam", "points_obj", "object_index"):
        assert np.array_equal(getattr(part, name)[inner], getattr(whole, name)[rows, columns]), name
    assert set(np.unique(part.object_index)) >= {0, 1}


def test_several_meshes_share_one_depth_buffer() -> None:
    mesh = quad(0.1)
    near, far = se3.make(np.eye(3), np.array([0, 0, 0.5])), se3.make(np.eye(3), np.array([0.05, 0, 0.6]))
    rendered = render([(mesh, far), (mesh, near)], CAMERA)
    alone = [render_depth(mesh, far, CAMERA), render_depth(mesh, near, CAMERA)]
    assert np.array_equal(rendered.object_index == 1, alone[1] > 0)
    assert np.array_equal(rendered.object_index == 0, (alone[0] > 0) & (alone[1] == 0))
    assert np.array_equal(rendered.depth, np.where(alone[1] > 0, alone[1], alone[0]))


def test_floor_that_passes_under_the_camera_is_clipped_at_the_near_plane() -> None:
    T = se3.make(se3.rotation_exp(np.array([np.pi / 2 - 0.2, 0, 0])), np.array([0, 0.1, 0.3]))
    rendered = render([(quad(5.0), T)], CAMERA)
    normal, r = T[:3, 2], rays()
    depth = (normal @ T[:3, 3]) / (r @ normal)
    hit = (r * depth[..., None] - T[:3, 3]) @ T[:3, :3]
    inside = (np.abs(hit[..., :2]) <= 5.0).all(-1) & (depth > 0.05)
    assert (inside ^ (rendered.depth > 0)).sum() <= 2
    both = inside & (rendered.depth > 0)
    np.testing.assert_allclose(rendered.depth[both], depth[both], rtol=1e-5)
    np.testing.assert_allclose(rendered.points_obj[both], hit[both], rtol=1e-4, atol=1e-5)


def test_behind_the_camera_and_outside_the_image_is_nothing() -> None:
    mesh = blob()
    for t in ([0, 0, -0.5], [3.0, 0, 0.5], [0, -2.0, 0.5]):
        rendered = render([(mesh, se3.make(np.eye(3), np.array(t, float)))], CAMERA)
        assert not rendered.depth.any()
        assert (rendered.object_index == -1).all()
        assert not rendered.color.any()


def test_shared_edges_leave_no_cracks() -> None:
    """A fan of thin triangles over a square: every pixel of the square is covered, at its depth."""
    rng = np.random.default_rng(3)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 400))
    rim: Float32 = np.stack([np.cos(angles), np.sin(angles), np.zeros(400)], -1).astype(np.float32)
    vertices = np.concatenate([np.zeros((1, 3), np.float32), rim])
    k = np.arange(400)
    faces = np.stack([np.zeros(400, int), k + 1, (k + 1) % 400 + 1], -1).astype(np.int32)
    fan = Mesh(vertices, faces, np.zeros((400, 3, 2), np.float32), np.zeros((2, 2, 3), np.uint8))
    T = se3.make(se3.rotation_exp(np.array([0.2, 0.3, 0.1])), np.array([0, 0, 1.2]))
    assert (render_depth(fan, T, CAMERA)[60:420, 120:500] > 0).all()


def test_without_colour_the_rest_is_there() -> None:
    rendered = render([(quad(), se3.make(np.eye(3), np.array([0, 0, 1.0])))], CAMERA, color=False)
    assert rendered.color.size == 0
    assert rendered.depth.shape == (480, 640)


def test_some_pixels_have_the_points_and_normals_of_all() -> None:
    """Two meshes and background in one image; pixels in any order."""
    rng = np.random.default_rng(4)
    T = se3.make(se3.rotation_exp(rng.normal(size=3)), np.array([-0.1, 0.0, 0.4]))
    rendered = render([(blob(), T), (quad(), se3.make(np.eye(3), np.array([0.7, 0, 1.0])))], CAMERA)
    assert set(np.unique(rendered.object_index)) == {-1, 0, 1}
    rows, columns = rng.integers(0, 480, 500), rng.integers(0, 640, 500)
    np.testing.assert_array_equal(rendered.points_at(rows, columns), rendered.points_obj[rows, columns])
    np.testing.assert_array_equal(rendered.normals_at(rows, columns), rendered.normals_cam[rows, columns])


@pytest.mark.parametrize("distance_m", [0.3, 0.1, 0.06])
def test_leaving_out_the_far_side_of_a_solid_changes_no_pixel(distance_m: float) -> None:
    """Also where the near plane cuts it open; a surface with a border keeps both sides."""
    solid = box_mesh((0.06, 0.06, 0.06))
    assert is_closed(solid.vertices, solid.faces)
    assert not is_closed(solid.vertices, solid.faces[:, ::-1])
    parts = slice(2, None), slice(2)
    bowl, lid = (Mesh(solid.vertices, solid.faces[k], solid.uv[k], solid.texture) for k in parts)
    assert not is_closed(bowl.vertices, bowl.faces)
    camera = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)
    for k in range(4):
        turn = se3.rotation_exp(np.array([0.4 * k, 1.0, 0.3 * k]))
        T = se3.make(turn, [0.01, 0.0, distance_m])
        for mesh, parts in ((solid, (bowl, lid)), (bowl, (bowl,))):
            rendered, whole = render([(mesh, T)], camera), render([(part, T) for part in parts], camera)
            assert (whole.depth > 0).any()
            assert np.array_equal(rendered.depth, whole.depth)
            assert np.array_equal(rendered.color, whole.color)
            assert np.array_equal(render_depth(mesh, T, camera), whole.depth)


def test_the_far_side_is_left_out_only_of_a_solid() -> None:
    solid = box_mesh((0.06, 0.06, 0.06))
    points = transform(solid.vertices, se3.make(np.eye(3), np.array([0.0, 0.0, 0.3])))
    far = solid.faces[(points[solid.faces, 2] > 0.3).all(1)]
    assert len(far) == 2
    for closed in (False, True):
        inverse, face = np.zeros((120, 160), np.float32), np.full((120, 160), -1, np.int32)
        rasterise(points, far, (300.0, 300.0), (79.5, 59.5), 0.01, closed, 0, inverse, face, face.copy())
        assert (inverse > 0).any() == (not closed)
