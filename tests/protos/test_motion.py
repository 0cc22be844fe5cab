"""Interpolated and predicted poses, against known motions."""

import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from huepose_protos.motion import (
    SECOND,
    composed,
    mount_at,
    mount_of,
    multiply,
    pose_at,
    quaternion_from,
    quaternion_of,
    rotation_matrix,
    rotation_vector,
)

POSE = example(PoseMessage)
LINEAR, ANGULAR = np.array([0.3, -0.2, 0.1]), np.array([0.5, 1.0, -0.7])
MS = SECOND // 1000


def _moving(seconds):
    """The example pose after a constant motion: along the camera's axes, about the object's origin."""
    rotation = quaternion_of(ANGULAR * seconds)
    return np.array(POSE.translation) + LINEAR * seconds, multiply(rotation, np.array(POSE.quaternion))


def _message(ms, **changes):
    translation, quaternion = _moving(ms * 1e-3)
    given = {
        "capture_ns": SECOND + ms * MS,
        "translation": tuple(translation.tolist()),
        "quaternion": tuple(quaternion.tolist()),
        "velocity_linear": tuple(LINEAR.tolist()),
        "velocity_angular": tuple(ANGULAR.tolist()),
        "centre": (0.0, 0.0, 0.0),
    }
    return msgspec.structs.replace(POSE, **(given | changes))


@pytest.mark.parametrize("ms", [0, 7, 20, 33, 50, 66, 100, 166])
def test_a_constant_motion_is_interpolated_and_predicted_exactly(ms):
    poses = [_message(0), _message(33), _message(66)]
    got = pose_at(poses, SECOND + ms * MS)
    translation, quaternion = _moving(ms * 1e-3)
    assert got.translation == pytest.approx(translation, abs=1e-12)
    assert abs(got.quaternion @ quaternion) == pytest.approx(1.0, abs=1e-12)
    assert got.ahead_s == pytest.approx(max(ms - 66, 0) * 1e-3)
    assert got.T_cam_obj[:3, :3] == pytest.approx(rotation_matrix(quaternion), abs=1e-12)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.1, -0.2, 0.3), (30.0, -20.0, 25.0)])
@pytest.mark.parametrize("ms", [0, 15, 50, 66, 100])
def test_the_centre_of_an_object_moves_straight_wherever_its_origin_is(ms, centre):
    def lever(seconds):
        return rotation_matrix(_moving(seconds)[1]) @ centre

    def message(at_ms):
        seconds = at_ms * 1e-3
        origin = np.array([0.1, 0.2, 0.8]) + LINEAR * seconds - lever(seconds)
        linear = LINEAR - np.cross(ANGULAR, lever(seconds))
        changes = {"translation": origin, "velocity_linear": linear, "centre": np.array(centre)}
        return _message(at_ms, **{name: tuple(value.tolist()) for name, value in changes.items()})

    got = pose_at([message(0), message(33), message(66)], SECOND + ms * MS)
    at_centre = got.translation + rotation_matrix(got.quaternion) @ centre
    assert at_centre == pytest.approx(np.array([0.1, 0.2, 0.8]) + LINEAR * ms * 1e-3, abs=1e-9)
    assert got.translation == pytest.approx(message(ms).translation, abs=1e-9)

    # The uncertainty of the centre does not depend on the origin either.
    to_centre = np.eye(6)
    to_centre[:3, 3:] = np.cross(np.eye(3), rotation_matrix(got.quaternion) @ centre).T
    known = to_centre @ np.array(message(66).covariance).reshape(6, 6) @ to_centre.T
    grown = to_centre @ got.covariance @ to_centre.T - known
    sigma = np.sqrt(np.diag(grown)) if ms > 66 else np.zeros(6)
    ahead = max(ms - 66, 0) * 1e-3
    assert sigma[:3] == pytest.approx(np.full(3, math.hypot(0.02 * ahead, 0.5 * ahead**2)), abs=1e-6)


@pytest.mark.parametrize("ms", [-1, 167, 10_000])
def test_no_pose_before_the_first_and_long_after_the_last(ms):
    assert pose_at([_message(0), _message(66)], SECOND + ms * MS) is None


def test_the_covariance_grows_with_the_time_ahead_and_stays_positive_definite():
    poses = [_message(0)]
    sigmas = []
    for ms in (0, 20, 50, 100):
        covariance = pose_at(poses, SECOND + ms * MS).covariance
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        sigmas.append(np.sqrt(np.diag(covariance)))
    assert sigmas[0] == pytest.approx(np.full(6, 1e-3))
    assert all((b > a).all() for a, b in pairwise(sigmas))
    # 0.02 m/s and 1 m/s2 for 0.1 s, on a millimetre.
    assert sigmas[-1][0] == pytest.approx(math.hypot(0.001, 0.002, 0.005))


def test_without_a_velocity_the_uncertainty_grows_faster():
    known = pose_at([_message(0)], SECOND + 50 * MS)
    still = pose_at([_message(0, velocity_linear=None, velocity_angular=None)], SECOND + 50 * MS)
    assert still.translation == pytest.approx(POSE.translation)
    assert np.diag(still.covariance)[0] > 10 * np.diag(known.covariance)[0]


def test_between_two_poses_the_worse_state_holds():
    got = pose_at([_message(0, state="SUSPECT", quality=0.3), _message(33)], SECOND + 10 * MS)
    assert (got.state, got.quality) == ("SUSPECT", 0.3)


def test_no_pose_while_lost_and_none_across_a_gap():
    gone = {"state": "LOST", "translation": None, "quaternion": None, "covariance": None}
    lost = [_message(0), _message(33, **gone)]
    assert pose_at(lost, SECOND + 40 * MS) is None
    assert pose_at(lost, SECOND + 20 * MS) is None
    gap = [_message(0), _message(500)]
    assert pose_at(gap, SECOND + 60 * MS).ahead_s == pytest.approx(0.06)
    assert pose_at(gap, SECOND + 300 * MS) is None


@pytest.mark.parametrize("vector", [[0, 0, 0], [1e-9, 0, 0], [0.1, -0.2, 0.3], [3.1, 0.1, 0.0]])
def test_rotation_vectors_survive_a_round_trip(vector):
    assert rotation_vector(quaternion_of(np.array(vector, float))) == pytest.approx(vector, abs=1e-12)


def test_a_moving_cameras_mount_is_interpolated_and_briefly_extrapolated():
    rotation = quaternion_of(np.array([0.0, 0.0, 0.2]))
    start = mount_of("base", np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    end = mount_of("base", np.array([1.1, 0.0, 0.0]), rotation)
    mounts = [(1_000_000_000, start), (1_100_000_000, end)]
    for ms, share in ((1000, 0.0), (1050, 0.5), (1100, 1.0), (1150, 1.5)):
        found = mount_at(mounts, ms * 1_000_000)
        assert found is not None
        assert np.allclose(found.translation, [1.0 + 0.1 * share, 0.0, 0.0])
        assert np.allclose(rotation_vector(np.array(found.quaternion)), [0.0, 0.0, 0.2 * share])
    assert mount_at(mounts, 999_000_000) is None
    assert mount_at(mounts, 1_201_000_000) is None, "too long after the last one"
    assert mount_at([mounts[0], (1_300_000_000, end)], 1_150_000_000) is None, "a gap"
    assert mount_at(mounts[:1], 1_010_000_000) is None
    assert mount_at([], 0) is None
    near = [(1_000_000_000, start), (1_002_000_000, end)]
    assert mount_at(near, 1_001_000_000) is not None
    assert mount_at(near, 1_010_000_000) is None, "noise over 2 ms is no velocity"


def test_composed_mounts_and_quaternions_of_matrices():
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(2, 4))
    outer, inner = (mount_of("base", rng.normal(size=3), q) for q in quaternions)
    both = composed(outer, inner)
    R, S = (rotation_matrix(np.array(m.quaternion)) for m in (outer, inner))
    assert np.allclose(rotation_matrix(np.array(both.quaternion)), R @ S)
    assert np.allclose(both.translation, R @ np.array(inner.translation) + np.array(outer.translation))
    assert np.allclose(rotation_matrix(quaternion_from(R)), R)
