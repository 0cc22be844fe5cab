"""Outlines, axes, labels, colours and point clouds, as they are drawn into an image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from huepose.geometry import Camera, se3
from huepose_services.viewer.shapes import (
    apart,
    axes,
    cloud,
    depth_range,
    drawable,
    label_size,
    outlines,
    yuv,
)
from tests.meshes import demo_objects

CAMERA = Camera(100.0, 100.0, 50.0, 40.0, 101, 81)


def test_an_outline_encloses_the_projected_mesh():
    mesh = demo_objects(0)["tea_box"]
    T_cam_obj = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]) - mesh.centre)
    (line,) = outlines(mesh, T_cam_obj, CAMERA)
    pixels = CAMERA.project(se3.apply(T_cam_obj, mesh.vertices))
    assert (line[0] == line[-1]).all(), "closed"
    assert line.min(0) == pytest.approx(pixels.min(0), abs=1.5)
    assert line.max(0) == pytest.approx(pixels.max(0), abs=1.5)


def test_nothing_behind_the_camera_is_drawn():
    mesh = demo_objects(0)["tea_box"]
    T_cam_obj = se3.make(np.eye(3), np.array([0.0, 0.0, -0.5]))
    assert outlines(mesh, T_cam_obj, CAMERA) == []
    assert axes(T_cam_obj, CAMERA, 0.1, mesh.centre) is None


def test_axes_begin_in_the_middle_and_point_along_the_image():
    T_cam_obj = se3.make(np.eye(3), np.array([0.0, 0.0, 0.5]))
    x, y, z = axes(T_cam_obj, CAMERA, 0.1, np.zeros(3))
    assert x == pytest.approx(np.array([[50, 40], [70, 40]]))
    assert y == pytest.approx(np.array([[50, 40], [50, 60]]))
    assert z == pytest.approx(np.array([[50, 40], [50, 40]]))


def test_the_point_cloud_lies_on_the_rays_of_its_pixels():
    depth = np.zeros((81, 101), np.uint16)
    depth[40, 50], depth[41, 60], depth[0, 0] = 5000, 7000, 65535
    color = np.arange(81 * 101 * 3, dtype=np.int64).reshape(81, 101, 3).astype(np.uint8)
    points, colors = cloud(color, depth, 0.0001, CAMERA, 1)
    assert points == pytest.approx(np.array([[0, 0, 0.5], [0.07, 0.007, 0.7]]), abs=1e-6)
    assert (colors == color[[40, 41], [50, 60]]).all()


@pytest.mark.parametrize(("shape", "shown"), [((1, 1024), (1, 512)), ((4096, 2), (512, 1))])
def test_a_texture_that_is_a_strip_of_colours_is_shown(shape, shown):
    mesh = replace(demo_objects(0)["tea_box"], texture=np.full((*shape, 3), 7, np.uint8))
    texture = drawable(mesh)["albedo_texture"]
    assert texture.shape == (*shown, 3)
    assert (texture == 7).all()


def test_a_drawable_mesh_has_the_same_triangles_and_a_small_texture():
    mesh = demo_objects(0)["tea_box"]
    shown = drawable(mesh)
    triangles = shown["triangle_indices"]
    assert (shown["vertex_positions"][triangles] == mesh.vertices[mesh.faces]).all()
    assert (shown["vertex_texcoords"][triangles] == mesh.uv).all()
    assert max(shown["albedo_texture"].shape) <= 512


def test_colours_survive_as_luma_and_chroma_planes():
    color = np.full((7, 9, 3), (200, 60, 30), np.uint8)
    planes, width, height = yuv(color)
    assert (width, height) == (8, 6)
    back = cv2.cvtColor(np.frombuffer(planes, np.uint8).reshape(9, 8), cv2.COLOR_YUV2RGB_I420)
    assert np.abs(back.astype(int) - color[:6, :8]).max() <= 3


@given(
    st.lists(
        st.tuples(
            st.floats(0, 640), st.floats(-50, 480), st.sampled_from(["can", "a box  suspect 0.61\nwhy"])
        ),
        max_size=8,
    )
)
def test_labels_do_not_overlap_and_stay_in_the_image(found):
    sizes = [label_size(text) for _, _, text in found]
    placed = apart([(x, y) for x, y, _ in found], sizes, 640, 480)
    boxes = [(x - w / 2, y, x + w / 2, y + h) for (x, y), (w, h) in zip(placed, sizes, strict=True)]
    tiny = 1e-6
    for k, (left, top, right, bottom) in enumerate(boxes):
        assert left >= -tiny
        assert top >= -tiny
        assert right <= 640 + tiny
        assert bottom <= 480 + tiny
        for l2, t2, r2, b2 in boxes[:k]:
            beside = left >= r2 - tiny or right <= l2 + tiny
            assert beside or top >= b2 - tiny or bottom <= t2 + tiny


def test_a_single_label_is_not_moved():
    assert apart([(300.0, 100.0)], [(80.0, 20.0)], 640, 480) == [(300.0, 100.0)]


def test_a_depth_image_without_readings_has_a_range():
    low, high = depth_range(np.zeros((4, 4), np.uint16))
    assert high > low
