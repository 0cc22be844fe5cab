"""A texture in the light that a pose implies: what shade leaves of its colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.colorpair.opponents import BYTES, LINEAR
from huepose.geometry import Mesh, RgbdFrame
from huepose.judge.implied_light import Light, implied_lights, shading_gains
from huepose.judge.kernel_arrays import model_arrays, region_arrays
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render
from tests.conftest import TakePicture, standing_pose
from tests.judge.regions import region_of
from tests.onboarded import onboarded
from tests.onboarding import solids

RED = (200, 30, 20)
LAMP = np.array([0.75, -0.55, -0.35])
"""Where the lamp is, camera axes: it lights one side of an object in front of the camera, and leaves another
in the shade."""

T = standing_pose(0.6, 0.0, 0.0)


@pytest.fixture(scope="module")
def brick() -> ReferenceModel:
    mesh = solids.box((0.06, 0.05, 0.09))
    return onboarded(replace(mesh, texture=np.full_like(mesh.texture, RED)), "brick", searched=False)


def in_lamplight(frame: RgbdFrame, mesh: Mesh, T_cam_obj: np.ndarray, ambient: float) -> RgbdFrame:
    """A frame in which the mesh at a pose (4, 4) is lit by the lamp, and by `ambient` from everywhere."""
    seen = render([(mesh, T_cam_obj)], frame.camera)
    strength = ambient + (1.0 - ambient) * np.clip(seen.normals_cam @ LAMP / np.linalg.norm(LAMP), 0.0, 1.0)
    linear = np.clip(LINEAR[seen.color] * strength[..., None], 0.0, 1.0)
    lit = BYTES[(np.sqrt(linear) * 1023.0 + 0.5).astype(np.int64)]
    return replace(frame, color=np.where(seen.depth[..., None] > 0, lit, frame.color))


def gain_and_light(model: ReferenceModel, region: Region) -> tuple[float, Light | None]:
    arrays, seen = model_arrays(model), region_arrays(region)
    lights = implied_lights(arrays, seen, T[None])
    return float(shading_gains(arrays, seen, T[None], lights)[0]), lights[0]


@pytest.mark.parametrize(("ambient", "gains"), [(0.03, True), (1.0, False)])
def test_only_a_brick_half_in_the_shade_gains_from_the_implied_light(
    ambient: float, gains: bool, brick: ReferenceModel, take_picture: TakePicture
) -> None:
    frame = in_lamplight(take_picture([(brick.mesh, T)]), brick.mesh, T, ambient)
    gain, _ = gain_and_light(brick, region_of(frame, brick, T))
    assert (gain > 0.3) == gains, gain
    assert gain > -0.02


def test_the_light_on_a_side_says_what_is_left_of_its_colour(
    brick: ReferenceModel, take_picture: TakePicture
) -> None:
    frame = in_lamplight(take_picture([(brick.mesh, T)]), brick.mesh, T, 0.03)
    _, light = gain_and_light(brick, region_of(frame, brick, T))
    assert light is not None
    surface = brick.surface
    towards = surface.normals @ T[:3, :3].T @ LAMP
    given = model_arrays(brick).colors
    lit = light.falls_on(given, surface.normals)
    assert np.array_equal(lit[..., 0], given[..., 0])  # shade is taken off lightness elsewhere
    bright, dark = towards > 0.5, towards < 0.0
    assert lit[0, bright, 1].mean() == pytest.approx(given[0, bright, 1].mean(), rel=0.1)
    assert lit[0, dark, 1].mean() < 0.5 * given[0, dark, 1].mean()


def test_without_depth_there_is_no_light(brick: ReferenceModel, take_picture: TakePicture) -> None:
    region = region_of(take_picture([(brick.mesh, T)]), brick, T)
    blind = replace(region, crop=replace(region.crop, depth=np.zeros_like(region.crop.depth)))
    assert gain_and_light(brick, blind) == (0.0, None)


def test_light_on_an_image_is_strongest_where_the_surface_faces_the_lamp() -> None:
    color = np.full((1, 4, 3), 100, np.uint8)
    normals = np.array([[[0, 0, -1], [0, -1, 0], [0, 0, 0], [-1, 0, 0]]], np.float32)
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # the object's x is the camera's y
    assert np.array_equal(Light(np.zeros(4)).falls_on_picture(color, normals, turned), color)
    lit = Light(np.array([np.log(0.5), -np.log(2.0), 0.0, 0.0])).falls_on_picture(color, normals, turned)
    half = int(np.abs(LINEAR - 0.5 * LINEAR[100]).argmin())
    np.testing.assert_allclose(lit[0, :, 0].astype(int), [half, 100, 100, half], atol=1)
