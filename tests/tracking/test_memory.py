"""A tracker that takes over the memory of another one then gives the same poses, bit by bit."""

from dataclasses import astuple
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from huepose.judge.terms import NOTHING
from huepose.support.errors import InputError
from huepose.tracking import Correction, Tracker, Verdict
from huepose.tracking.camera_place import CameraPlace
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.memory import checksum, frames_of, plain, restored, state_of, taken_over


@pytest.fixture
def film(tea_box, shoot, path):
    """Frames of the carried box; it jumps at frame 9."""
    return [shoot([(tea_box.mesh, path(k if k < 9 else k + 12))], k) for k in range(14)]


def _correction(frame, T, seq, verdict):
    mask = np.zeros(frame.depth.shape, bool)
    return Correction("tea_box", 0, frame.epoch, frame.frame_id, frame.stamp_ns, T, 0.9, verdict, seq, mask)


def _bits(pose):
    return [x.tobytes() if isinstance(x, np.ndarray) else x for x in astuple(pose)]


@pytest.mark.parametrize("taken_over_after", [0, 3, 7, 10])
def test_a_tracker_that_takes_over_a_memory_gives_the_same_poses(tea_box, film, path, taken_over_after):
    first, other = (Tracker({"tea_box": tea_box}) for _ in range(2))
    kept = {}
    for k, frame in enumerate(film):
        kept[frame.epoch, frame.frame_id] = frame
        trackers = [first] if k <= taken_over_after else [first, other]
        for tracker in trackers:
            if k == 2:
                # A correction that waits for its frame or is caught up is part of the memory.
                tracker.correct(_correction(film[0], path(0), 1, Verdict.ACQUIRE))
            if k == 7:
                tracker.correct(_correction(film[4], path(4), 2, Verdict.AGREE))
            if k == 10:
                tracker.correct(_correction(film[9], path(21), 3, Verdict.CORRECT))
        poses = [[_bits(pose) for pose in tracker.step(frame)] for tracker in trackers]
        assert poses[0] == poses[-1]
        assert len({checksum(tracker) for tracker in trackers}) == 1
        if k == taken_over_after:
            memory = state_of(first)
            assert set(frames_of(memory)) <= set(kept)
            taken_over(other, memory, lambda epoch, frame_id: kept.get((epoch, frame_id)))
    assert len(poses[0]) == 1


def test_velocities_beside_a_static_camera_are_the_same_after_a_memory_is_taken_over():
    pixels = np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.float32), Camera(4.0, 4.0, 2.0, 2.0, 4, 4)
    frame = RgbdFrame(*pixels, 1, 33_000_000, T_parent_cam=np.eye(4))
    camera, _ = CameraPlace(np.eye(4)).after(frame, 0)
    tracker = Tracker({})
    again = restored(plain(camera, tracker), tracker, lambda epoch, frame_id: None)
    velocity, surface = np.full(6, 0.1), SimpleNamespace(centre_cam=lambda T: T[:3, 3])
    T_cam_obj = se3.make(se3.rotation_exp(np.array([0.3, 0.5, 0.7])), np.array([0.1, 0.2, 0.7]))
    h = Hypothesis(T_cam_obj, NOTHING, np.zeros((6, 6)), "still", velocity=velocity)
    for place in (camera, again):
        assert place.relative(surface, h).velocity.tobytes() == velocity.tobytes()


def test_the_checksum_changes_with_a_single_bit(tea_box, film, path):
    tracker = Tracker({"tea_box": tea_box})
    tracker.correct(_correction(film[0], path(0), 1, Verdict.ACQUIRE))
    tracker.step(film[0])
    before = checksum(tracker)
    tracker._tracks["tea_box", 0].hypotheses[0].T_cam_obj[0, 3] += 1e-16
    assert checksum(tracker) != before


@pytest.mark.parametrize(
    "damage",
    [
        lambda memory: {},
        lambda memory: [],
        lambda memory: memory | {"_tracks": {"class": "Popen", "has": {}}},
        lambda memory: memory | {"_whose_turn": {"frame": [1, 99]}},
        lambda memory: memory | {"_whose_turn": {"subject": "mug"}},
        lambda memory: (
            memory
            | {"_whose_turn": {"array": b"1234", "dtype": "|O", "shape": [1], "order": "C", "scalar": False}}
        ),
        lambda memory: (
            memory
            | {"_whose_turn": {"array": b"", "dtype": "<f8", "shape": [2**40], "order": "C", "scalar": False}}
        ),
    ],
)
def test_an_invalid_memory_is_refused_and_changes_nothing(tea_box, damage):
    tracker = Tracker({"tea_box": tea_box})
    before = state_of(tracker)
    with pytest.raises(InputError, match="the tracker's memory"):
        taken_over(tracker, damage(before), lambda epoch, frame_id: None)
    assert state_of(tracker) == before
