from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from huepose.geometry import Mesh, se3
from huepose.model.types import Surface
from huepose.onboarding.cloud import Cloud, visible_cloud
from huepose.onboarding.near_symmetries import NearSymmetries, even_rotations, near_symmetries
from huepose.onboarding.reference import diameter_of
from huepose.onboarding.surface import build_grid, build_surface
from huepose.onboarding.symmetries import equivalent_rotations, rotations_about_own
from huepose.onboarding.visibility import depth_views
from huepose.support.errors import InputError
from tests.onboarding import solids

Analysed = tuple[NearSymmetries, np.ndarray, Callable[[str], np.ndarray]]


def surface_of(mesh: Mesh) -> tuple[float, Cloud, Surface]:
    """Diameter, cloud and surface of a mesh."""
    diameter = diameter_of(mesh)
    views = depth_views(mesh, diameter, level=2)
    cloud = visible_cloud(mesh, views)
    return diameter, cloud, build_surface(cloud, views)


def analysed(mesh: Mesh) -> Analysed:
    """Near-symmetric and equivalent rotations of a mesh, and a function of an axis name: the rotations
    about it."""
    diameter, cloud, surface = surface_of(mesh)
    near = near_symmetries(surface, build_grid(surface.points, diameter), diameter)
    equivalents = equivalent_rotations(surface, cloud, near, diameter)
    return near, equivalents, partial(rotations_about_own, surface, near, diameter)


def angles_to(turns: np.ndarray, R: np.ndarray) -> np.ndarray:
    return np.degrees([se3.rotation_angle(T, R) for T in turns])


def half_turn(axis: int) -> np.ndarray:
    return 2 * np.diag(np.eye(3)[axis]) - np.eye(3)


@pytest.fixture(scope="module")
def bricks() -> tuple[Analysed, Analysed]:
    """A box off its origin, with a texture on every side, and the same box in one colour."""
    rng = np.random.default_rng(4)
    blots = {
        side: np.kron(rng.integers(0, 256, (4, 4, 3)), np.ones((16, 16, 1))).astype(np.uint8)
        for side in solids.SIDES
    }
    extents = (0.12, 0.08, 0.05)
    printed, blank = (solids.moved(solids.box(extents, p), (0.02, 0.0, -0.01)) for p in (blots, None))
    return analysed(printed), analysed(blank)


def test_a_printed_box_has_flips_of_its_shape_only(bricks) -> None:
    near, equivalents, _ = bricks[0]
    np.testing.assert_array_equal(near.transforms[0], np.eye(4))
    for axis in range(3):
        k = angles_to(near.transforms, half_turn(axis)).argmin()
        assert angles_to(near.transforms[k : k + 1], half_turn(axis))[0] < 1.5
        centre = np.array([0.02, 0.0, -0.01])
        np.testing.assert_allclose(se3.apply(near.transforms[k], centre), centre, atol=1e-3)
    assert len(equivalents) == 1
    np.testing.assert_array_equal(equivalents[0], np.eye(4))


def test_a_printed_box_has_a_half_turn_about_its_own_y_axis(bricks) -> None:
    turns = bricks[0][2]("y")
    assert len(turns) == 2
    np.testing.assert_array_equal(turns[0], np.eye(4))
    assert angles_to(turns[1:], half_turn(1))[0] < 1.5


def test_a_shape_without_a_rotation_about_the_axis_is_refused() -> None:
    near = NearSymmetries(np.eye(4)[None])
    with pytest.raises(InputError, match=r"no rotation about the object's z axis .* a file can declare"):
        rotations_about_own(None, near, 0.1, "z")


def test_a_blank_box_has_equivalent_flips(bricks) -> None:
    equivalents = bricks[1][1]
    assert len(equivalents) == 4
    for axis in range(3):
        assert angles_to(equivalents, half_turn(axis)).min() < 1.5


def test_near_symmetric_rotations_do_not_depend_on_the_texture(bricks) -> None:
    np.testing.assert_array_equal(bricks[0][0].transforms, bricks[1][0].transforms)


def test_a_cube_has_24_rotations() -> None:
    near, equivalents, _ = analysed(solids.box((0.07, 0.07, 0.07)))
    assert len(near.transforms) == 24
    assert len(equivalents) == 24
    rounded = np.round(near.transforms[:, :3, :3])
    assert len({tuple(R.reshape(-1)) for R in rounded}) == 24
    np.testing.assert_allclose(near.transforms[:, :3, :3], rounded, atol=0.05)


def test_a_plain_cylinder_has_rotations_about_its_axis_and_flips() -> None:
    near, equivalents, _ = analysed(solids.moved(solids.cylinder(0.03, 0.1), (0.0, 0.04, 0.0)))
    assert near.axis is not None
    assert near.offset is not None
    assert abs(near.axis[2]) > np.cos(np.radians(0.5))
    np.testing.assert_allclose(near.offset[:2], [0.0, 0.04], atol=5e-4)
    assert len(near.transforms) == 48
    assert len(equivalents) == 144
    up = equivalents[:, 2, 2]
    assert (np.abs(up) > 0.999).all()
    assert (up > 0).sum() == 72
    around = np.sort(np.degrees(np.arctan2(equivalents[up > 0, 1, 0], equivalents[up > 0, 0, 0])) % 360)
    np.testing.assert_allclose(np.diff(around), 5.0, atol=0.1)


def label(repeats: int) -> np.ndarray:
    """A wrapper that repeats round the can; its upper and lower halves differ."""
    columns = np.arange(360) % (360 // repeats)
    picture = np.full((64, 360, 3), (200, 200, 40), np.uint8)
    picture[20:32, columns < 360 // repeats // 3] = (20, 30, 160)
    picture[36:42, columns > 360 // repeats // 2] = (160, 20, 30)
    return picture


def test_a_printed_can_has_no_equivalent_rotation() -> None:
    near, equivalents, about = analysed(solids.cylinder(0.03, 0.1, label(1)))
    assert len(near.transforms) == 48
    assert len(equivalents) == 1
    about_its_axis = about("z")
    assert len(about_its_axis) == 72
    assert (about_its_axis[:, 2, 2] > 0.999).all()
    assert len(about("x")) == 2


def test_a_ball_has_rotations_about_every_axis() -> None:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 33)
    profile = [(0.03 * max(np.cos(a), 0.0), 0.03 * np.sin(a)) for a in angles]
    profile[0], profile[-1] = (0.0, -0.03), (0.0, 0.03)
    ball = solids.lathe(profile, np.full((8, 8, 3), (220, 120, 20), np.uint8))
    diameter, _, surface = surface_of(solids.moved(ball, (0.0, 0.05, 0.0)))
    some_axis = NearSymmetries(np.eye(4)[None], np.array([0.28, 0, 0.96]), np.array([0, 0.05, 0]))
    for k, axis in enumerate("xyz"):
        turns = rotations_about_own(surface, some_axis, diameter, axis)
        assert len(turns) == 72
        np.testing.assert_allclose(turns[:, k, k], 1.0, atol=1e-9)
        np.testing.assert_allclose(se3.apply(turns[18], [0.0, 0.05, 0.0]), [0.0, 0.05, 0.0], atol=1e-3)


def test_a_wrapper_that_repeats_three_times_has_three_equivalent_rotations() -> None:
    _, equivalents, _ = analysed(solids.cylinder(0.03, 0.1, label(3)))
    assert len(equivalents) == 3
    turns = np.sort(np.degrees(np.arctan2(equivalents[:, 1, 0], equivalents[:, 0, 0])) % 360)
    np.testing.assert_allclose(turns, [0, 120, 240], atol=0.5)


def test_a_handle_breaks_the_symmetry_of_a_plain_mug() -> None:
    body = solids.cylinder(0.035, 0.09)
    handle = solids.moved(solids.box((0.03, 0.012, 0.05)), (0.05, 0.0, 0.0))
    _, equivalents, _ = analysed(solids.joined(body, handle))
    about_z = np.abs(equivalents[:, 2, 2]) > 0.99
    turned = np.degrees(np.arctan2(equivalents[about_z, 1, 0], equivalents[about_z, 0, 0]))
    upright = equivalents[about_z][:, 2, 2] > 0
    assert np.abs(turned[upright]).max() < 1  # only the mirror-like half turn about the handle may remain


def test_even_rotations_cover_all_orientations() -> None:
    rotations = even_rotations(1500)
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (1500, 1, 1)), atol=1e-12
    )
    rng = np.random.default_rng(6)
    for _ in range(100):
        R = se3.rotation_from_quaternion(rng.normal(size=4))
        best = (np.einsum("nij,ij->n", rotations, R).max() - 1) / 2
        assert np.degrees(np.arccos(best)) < 25
