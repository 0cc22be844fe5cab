"""The close look: rendered views show what the camera sees, outlines are found to the pixel, and of poses
that the shape cannot distinguish the right one wins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.judge.kernel_arrays import region_arrays
from huepose.judge.outline import PRIOR, Rim, edge_tensor, rim_agreement
from huepose.judge.region import Region
from huepose.judge.rendered_view import SHARP_PX, detail_colors, render_view
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.select.near_ties import close_look
from tests.conftest import TakePicture
from tests.judge.regions import region_of

UPSIDE_DOWN = se3.make(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


def moved(T: np.ndarray, x: float, y: float = 0.0) -> np.ndarray:
    return se3.compose(se3.make(np.eye(3), [x, y, 0.0]), T)


@pytest.fixture(scope="module")
def frame(tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray) -> RgbdFrame:
    return take_picture([(tea_box.mesh, standing)], light=(0.9, 0.7, 0.5))


@pytest.fixture(scope="module")
def region(frame: RgbdFrame, tea_box: ReferenceModel, standing: np.ndarray) -> Region:
    return region_of(frame, tea_box, standing)


def test_samples_of_a_rendered_view_lie_on_the_visible_surface(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    camera = region.crop.camera
    view = render_view(tea_box, standing, camera, 500)
    assert view is not None
    arrays = view.arrays
    assert len(arrays.visible) == arrays.offsets[1] == 500
    points = arrays.points[arrays.visible] @ standing[:3, :3].T + standing[:3, 3]
    pixels = np.rint(camera.project(points)).astype(int)
    depth = region.crop.depth[pixels[:, 1], pixels[:, 0]]
    assert np.abs(depth - points[:, 2]).max() < 0.0015
    normals = arrays.normals[arrays.visible] @ standing[:3, :3].T
    assert ((normals * points).sum(1) < 0.0).all()
    assert np.array_equal(arrays.points[: arrays.visible[0]], tea_box.surface.points)
    # Its detail is that of the image: coloured light is an offset, which detail does not have.
    seen = detail_colors(region.crop.color, np.ones(depth_shape(region), np.float32))
    inner = render_depth(tea_box.mesh, standing, camera)[pixels[:, 1], pixels[:, 0]] > 0
    a, b = arrays.colors[0][arrays.visible][inner], seen[0, pixels[:, 1], pixels[:, 0]][inner]
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.8


def depth_shape(region: Region) -> tuple[int, ...]:
    return region.crop.depth.shape


def test_detail_is_without_the_colour_of_the_light() -> None:
    rng = np.random.default_rng(0)
    texture = rng.integers(60, 200, (40, 40, 3)).astype(np.uint8)
    even = np.full((40, 40, 3), (90, 140, 200), np.uint8)
    weight = np.ones((40, 40), np.float32)
    assert np.abs(detail_colors(even, weight)[0]).max() < 1e-3
    assert detail_colors(texture, weight)[0].std() > 3.0
    assert SHARP_PX < 1.0


def test_an_outline_agrees_where_the_object_is_and_not_beside_it(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    view = render_view(tea_box, standing, region.crop.camera, 200)
    assert view is not None
    arrays = region_arrays(region)
    rim = Rim(view.rim_points, view.rim_inward, edge_tensor(region.crop.color), 1.0)
    there = rim_agreement(standing, rim, arrays)
    assert there > 0.55
    assert all(
        rim_agreement(moved(standing, x, y), rim, arrays) < there - 0.1
        for x, y in ((0.006, 0.0), (-0.006, 0.0), (0.0, 0.006))
    )
    none = Rim(np.zeros((0, 3)), np.zeros((0, 3)), rim.edges, 1.0)
    assert rim_agreement(standing, none, arrays) == pytest.approx(PRIOR)


def test_an_occluded_outline_says_nothing(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    view = render_view(tea_box, standing, region.crop.camera, 200)
    assert view is not None
    rim = Rim(view.rim_points, view.rim_inward, edge_tensor(region.crop.color), 1.0)
    wall = replace(region, crop=replace(region.crop, depth=np.full_like(region.crop.depth, 0.3)))
    assert rim_agreement(standing, rim, region_arrays(wall)) == pytest.approx(PRIOR)


def test_a_pose_a_few_pixels_off_is_corrected(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    near = se3.perturb(standing, np.array([0.003, -0.002, 0.002, 0.03, -0.02, 0.03]))
    look = close_look(tea_box, region, near[None], [None])
    assert look is not None
    found = look.poses[0]
    assert np.linalg.norm(found[:3, 3] - standing[:3, 3]) < 0.0012
    assert se3.rotation_angle(found, standing) < np.radians(0.8)


def test_the_same_pixels_tell_the_right_orientation(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    look = close_look(tea_box, region, np.stack([standing @ UPSIDE_DOWN, standing]), [None, None])
    assert look is not None
    assert look.alike.detail[1] > 0.8 > 0.4 > look.alike.detail[0]
    assert look.alike.broad[1] > look.alike.broad[0] + 0.1


def test_an_object_behind_the_camera_has_no_rendered_view(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    camera = region.crop.camera
    behind = se3.compose(se3.make(np.eye(3), [0.0, 0.0, -2.0]), standing)
    assert render_view(tea_box, behind, camera, 200) is None
    assert close_look(tea_box, region, behind[None], [None]) is None


def test_poses_beside_the_crop_are_not_looked_at(
    region: Region, tea_box: ReferenceModel, standing: np.ndarray
) -> None:
    beside = np.stack([moved(standing, x=3.0), moved(standing, x=3.1)])
    assert close_look(tea_box, region, beside, [None, None]) is None
