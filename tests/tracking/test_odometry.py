"""Visual odometry: the camera motion measured from the images."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.geometry import Box, Camera, Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Float64
from huepose.tracking import Tracker, TrackerConfig
from huepose.tracking.memory import checksum, state_of, taken_over
from huepose.tracking.odometry import Odometry
from tests.tracking.conftest import correction, errors

T_ROOM_BOX = se3.make(se3.rotation_exp(np.array([1.9, 0.3, 0.4])), np.array([0.0, 0.0, 0.55]))
CONFIG = TrackerConfig(odometry=True)
SKEW = np.array([0.3, -0.2, 0.0])


@pytest.fixture(scope="module")
def wall() -> tuple[Mesh, Float64]:
    """A slanted wall of printed tiles 1 m ahead, and its pose T_room_mesh."""
    corners = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[faces]
    tiles = np.random.default_rng(3).integers(20, 235, (48, 48, 3)).astype(np.uint8)
    print_ = np.repeat(np.repeat(tiles, 8, 0), 8, 1)
    return Mesh(corners, faces, uv, print_), se3.make(se3.rotation_exp(SKEW), np.array([0.0, 0.0, 1.0]))


def camera_at(number: float) -> Float64:
    """T_room_cam of a camera on a hand: up to 0.4 m/s and 40 degrees per second."""
    t = number / 30.0
    turn = se3.rotation_exp(np.array([0.1 * np.sin(4.0 * t), 0.12 * np.sin(3.5 * t), 0.15 * np.sin(3.0 * t)]))
    return se3.make(turn, np.array([0.06 * np.sin(5.0 * t), 0.05 * np.sin(4.0 * t), 0.03 * np.sin(6.0 * t)]))


@pytest.fixture
def walked(tea_box, wall, shoot):
    """A function of a frame number: the frame of that camera, and the pose of a static box."""

    def take(number: int, pace: float = 1.0):
        T_cam_room = se3.inverse(camera_at(pace * number))
        mesh, T_room_mesh = wall
        T_cam_box = se3.compose(T_cam_room, T_ROOM_BOX)
        return shoot(
            [(mesh, se3.compose(T_cam_room, T_room_mesh)), (tea_box.mesh, T_cam_box)], number
        ), T_cam_box

    return take


@pytest.mark.parametrize("step", [1, 3, 5, 8])
def test_the_pose_of_a_moving_camera_is_measured(walked, step) -> None:
    odometry = Odometry()
    for number in range(0, 45, step):
        T_room_cam = odometry.placed(walked(number)[0], list).T_parent_cam
        off = se3.compose(se3.inverse(camera_at(number)), T_room_cam)
        assert 1e3 * np.linalg.norm(off[:3, 3]) < 6.0
        assert np.degrees(se3.rotation_angle(off, np.eye(4))) < 0.5
    assert np.linalg.norm(T_room_cam[:3, 3]) > 0.05


@pytest.mark.parametrize("sideways", [0.0, 0.25])
def test_a_step_too_large_for_tracked_corners_is_measured_by_matched_features(
    tea_box, wall, shoot, sideways
) -> None:
    """The image rotates by 30 degrees, and shifts by a third of its width."""
    odometry, (tiles, T_room_mesh) = Odometry(), wall
    mesh = replace(tiles, vertices=0.5 * tiles.vertices)
    T_room_cam = se3.make(se3.rotation_exp(np.array([0.1, sideways, 0.52])), np.array([0.05, 0.0, 0.03]))
    for number, T in enumerate((np.eye(4), T_room_cam)):
        placed = odometry.placed(shoot([(mesh, se3.compose(se3.inverse(T), T_room_mesh))], 10 * number), list)
    off = se3.compose(se3.inverse(T_room_cam), placed.T_parent_cam)
    assert 1e3 * np.linalg.norm(off[:3, 3]) < 6.0
    assert np.degrees(se3.rotation_angle(off, np.eye(4))) < 0.5


@pytest.mark.parametrize("axis", ["roll", "forwards"])
def test_a_camera_that_rolls_or_moves_forwards_is_measured(wall, shoot, axis) -> None:
    """Then the middle of the image stays where it is."""
    odometry = Odometry()
    for number in range(6):
        angle, way_m = (np.radians(4.0 * number), 0.0) if axis == "roll" else (0.0, 0.03 * number)
        T_room_cam = se3.make(se3.rotation_exp(np.array([0.0, 0.0, angle])), np.array([0.0, 0.0, way_m]))
        frame = shoot([(wall[0], se3.compose(se3.inverse(T_room_cam), wall[1]))], number)
        off = se3.compose(se3.inverse(T_room_cam), odometry.placed(frame, list).T_parent_cam)
        assert 1e3 * np.linalg.norm(off[:3, 3]) < 6.0
        assert np.degrees(se3.rotation_angle(off, np.eye(4))) < 0.5


def test_an_object_that_moves_before_a_static_camera_does_not_move_it(tea_box, wall, shoot, path) -> None:
    odometry = Odometry()
    for number in range(30):
        T_room_cam = odometry.placed(shoot([wall, (tea_box.mesh, path(number))], number), list).T_parent_cam
        np.testing.assert_array_equal(T_room_cam, np.eye(4))


def test_tracked_objects_do_not_count_for_the_camera_motion(tea_box, shoot, path) -> None:
    """The wall has no corners: only the printed box moves."""
    bare = [(Mesh(*_bare_wall()), se3.make(np.eye(3), np.array([0.0, 0.0, 1.0])))]
    places = {}
    for tracked in (True, False):
        odometry = Odometry()
        for number in range(6):
            T = path(2 * number)
            T[2, 3] = 0.3
            frame = shoot([*bare, (tea_box.mesh, T)], number, noise=0.3)
            box = [Box(0.0, 0.0, 320.0, 240.0)] if tracked else []
            places[tracked] = odometry.placed(frame, partial(list, box)).T_parent_cam
    np.testing.assert_array_equal(places[True], np.eye(4))
    assert np.linalg.norm(places[False][:3, 3]) > 0.01, "without it, the camera seems to move"


def _bare_wall():
    corners = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[faces]
    return corners, faces, uv, np.full((4, 4, 3), 120, np.uint8)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0, 6.0])
def test_noise_on_a_smooth_wall_is_no_motion(sigma) -> None:
    """Noise looks like corners that move at random."""
    odometry, rng = Odometry(), np.random.default_rng(5)
    camera = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
    grey = np.broadcast_to(120.0 + np.linspace(-40.0, 40.0, 640)[:, None], (480, 640, 1))
    depth = np.broadcast_to(np.linspace(1.0, 1.1, 640, dtype=np.float32), (480, 640))
    for number in range(30):
        color = (grey + rng.normal(0.0, sigma, (480, 640, 3))).clip(0, 255).astype(np.uint8)
        frame = RgbdFrame(color, depth.copy(), camera, number, round(number * 1e9 / 30))
        np.testing.assert_array_equal(odometry.placed(frame, list).T_parent_cam, np.eye(4))


def test_a_board_that_passes_before_a_static_tracked_object_does_not_move_the_camera(
    tea_box, wall, shoot
) -> None:
    tiles = wall[0]
    board = replace(tiles, vertices=0.3 * tiles.vertices)
    T_box = se3.make(se3.rotation_exp(np.array([1.9, 0.3, 0.4])), np.array([0.0, 0.05, 0.45]))
    around = Box(90.0, 70.0, 140.0, 140.0)
    for tracked in (True, False):
        odometry = Odometry()
        for number in range(20):
            T_board = se3.make(np.eye(3), np.array([-0.8 + 0.04 * number, 0.0, 0.8]))
            frame = shoot([(board, T_board), (tea_box.mesh, T_box)], number, noise=0.3)
            T_room_cam = odometry.placed(frame, partial(list, [around] * tracked)).T_parent_cam
        assert (np.linalg.norm(T_room_cam[:3, 3]) < 1e-3) == tracked


def test_images_without_colour_or_depth_give_no_motion(shoot, walked) -> None:
    odometry = Odometry()
    black = replace(shoot([]), color=np.zeros((240, 320, 3), np.uint8))
    no_depth = replace(shoot([]), depth=np.zeros((240, 320), np.float32))
    for frame in (black, no_depth, walked(0)[0], black, no_depth, black):
        np.testing.assert_array_equal(odometry.placed(frame, list).T_parent_cam, np.eye(4))


@pytest.mark.parametrize(("width", "height"), [(2, 2), (1280, 2), (2, 720), (40, 30)])
def test_images_of_any_size_are_accepted(width, height) -> None:
    odometry = Odometry()
    for number in range(4):
        color = np.random.default_rng(number).integers(0, 255, (height, width, 3)).astype(np.uint8)
        camera = Camera(300.0, 300.0, width / 2, height / 2, width, height)
        frame = RgbdFrame(color, np.ones((height, width), np.float32), camera, number, number * 33_000_000)
        np.testing.assert_array_equal(odometry.placed(frame, list).T_parent_cam, np.eye(4))


@pytest.mark.parametrize("odometry", [True, False])
def test_a_static_object_before_a_moving_camera_is_tracked_at_large_steps(tea_box, walked, odometry) -> None:
    tracker, good = Tracker({"tea_box": tea_box}, replace(CONFIG, odometry=odometry, tries_per_s=0.0)), 0
    for number in range(0, 90, 5):
        frame, T_cam_box = walked(number)
        if number == 0:
            tracker.correct(correction(frame, T_cam_box))
        (pose,) = tracker.step(frame)
        good += pose.state is State.TRACKING and errors(pose, T_cam_box)[0] < 3.0
    assert (good >= 15) == odometry


def test_a_slow_camera_is_not_measured(walked) -> None:
    odometry = Odometry()
    for number in range(30):
        seen = odometry.placed(walked(number, 0.1)[0], partial(pytest.fail, "objects were asked for"))
        np.testing.assert_array_equal(seen.T_parent_cam, np.eye(4))


def test_poses_given_later_are_in_the_axes_of_the_measured_ones(walked) -> None:
    odometry, T_base_room = Odometry(), se3.make(se3.rotation_exp(SKEW), np.array([3.0, 0.0, 1.0]))
    for number in range(30):
        frame, _ = walked(number)
        if number > 15:
            frame = replace(frame, T_parent_cam=se3.compose(T_base_room, camera_at(number)))
        T_room_cam = odometry.placed(frame, list).T_parent_cam
        off = se3.compose(se3.inverse(camera_at(number)), T_room_cam)
        assert 1e3 * np.linalg.norm(off[:3, 3]) < 6.0
        assert np.degrees(se3.rotation_angle(off, np.eye(4))) < 0.5


def test_poses_given_from_the_first_frame_on_are_used_unchanged(walked) -> None:
    odometry = Odometry()
    for number in range(0, 12, 3):
        frame = replace(walked(number)[0], T_parent_cam=camera_at(number))
        assert odometry.placed(frame, list) is frame
    frame, _ = walked(12)
    assert odometry.placed(frame, list) is frame, "the next given pose is better"


@pytest.mark.parametrize("first_given", [0, 4])
def test_a_second_after_the_last_given_pose_odometry_takes_over(walked, first_given) -> None:
    """Without a jump, in the axes of the given poses; poses given again are in these axes, too."""
    odometry, T_base_room = Odometry(), se3.make(se3.rotation_exp(SKEW), np.array([3.0, 0.0, 1.0]))
    T_room = T_base_room if first_given == 0 else np.eye(4)
    for number in range(0, 90, 2):
        frame, _ = walked(number)
        if first_given <= number <= 10 or number > 60:
            frame = replace(frame, T_parent_cam=se3.compose(T_base_room, camera_at(number)))
        seen = odometry.placed(frame, list)
        if 10 < number <= 40:
            assert seen is frame, "a pose may be given again within a second"
            continue
        off = se3.compose(se3.inverse(se3.compose(T_room, camera_at(number))), seen.T_parent_cam)
        assert 1e3 * np.linalg.norm(off[:3, 3]) < 12.0, "the hand moves by up to 7 cm to each side"
        assert np.degrees(se3.rotation_angle(off, np.eye(4))) < 1.0


def test_single_frames_without_a_given_pose_change_nothing(walked) -> None:
    odometry = Odometry()
    for number in range(0, 40, 2):
        frame = walked(number)[0]
        if number % 6 == 0:
            frame = replace(frame, T_parent_cam=camera_at(number))
        assert odometry.placed(frame, list) is frame


def test_odometry_works_after_the_clock_was_set_back(walked) -> None:
    odometry = Odometry()
    odometry.placed(replace(walked(60)[0], T_parent_cam=camera_at(60)), list)
    assert odometry.placed(walked(0)[0], list).T_parent_cam is not None


def test_a_restored_tracker_continues_at_the_same_camera_pose(tea_box, walked) -> None:
    first, other = (Tracker({"tea_box": tea_box}, CONFIG) for _ in range(2))
    frames = {}
    for number in range(16):
        frame, T_cam_box = walked(number)
        frames[frame.epoch, number] = frame
        for tracker in [first] if number <= 8 else [first, other]:
            if number in (2, 12):
                tracker.correct(correction(frames[1, number - 2], walked(number - 2)[1], number))
            tracker.step(frame)
        if number == 8:
            taken_over(other, state_of(first), lambda epoch, frame_id: frames.get((epoch, frame_id)))
        if number >= 8:
            assert checksum(first) == checksum(other)
    assert errors(other.poses()[0], T_cam_box)[0] < 3.0
