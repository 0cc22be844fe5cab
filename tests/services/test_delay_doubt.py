"""If depth is older than colour, moving objects are not TRACKING, static ones are, and health reports it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose import tracking
from huepose_protos.messages import FrameHeader
from huepose_services.convert import frame_from_wire
from huepose_services.delay_doubt import DelayDoubt
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import CameraConfig, Config
from huepose_services.tracker import TrackerWork
from tests.conftest import standing_pose
from tests.services.fake_bus import sent
from tests.services.tracker_work import BusStandIn, ObjectsStandIn

HZ, MOVES, RESTS = 30, 45, 40
CAN = standing_pose(0.0, 0.25, 0.1)
LATE = "Depth is about "


def path(t):
    """Back and forth on a table, up to 0.3 m/s, and then at rest."""
    t = min(max(t, 0.0), MOVES / HZ)
    return standing_pose(0.6 + 0.3 * t, 0.06 * np.sin(5.0 * t) - 0.05, 0.04 * np.cos(4.0 * t))


@pytest.fixture(scope="module")
def sequence(box_and_can, take_picture):
    """A function of the delay in frames: headers and payloads of a box that moves, then rests; and a can."""
    meshes = [model.mesh for model in box_and_can.values()]
    seen = [
        take_picture(list(zip(meshes, (path(k / HZ), CAN), strict=True)), frame_id=k)
        for k in range(MOVES + 1)
    ]

    def shown(late):
        begun_ns = now_ns()
        for k in range(MOVES + RESTS):
            color, depth = seen[min(k, MOVES)], seen[min(max(k - late, 0), MOVES)].depth
            pixels = color.color.copy()
            pixels[0, 0] = k  # no two images are the same
            at_ns = begun_ns + round(k * 1e9 / HZ)
            yield sent(replace(color, color=pixels, depth=depth), frame_id=k, capture_ns=at_ns)

    return shown


def begun(models, config, at):
    work = TrackerWork(BusStandIn(), tracking.Tracker(models), ObjectsStandIn(), config, lambda: at[-1])
    return work, work._bus


def played(models, sequence, late, check=True, handed_over_at=None):
    """The published poses of each object, one a frame, and the tracker's warnings at the end."""
    frames = list(sequence(late))
    decoded = {(h.camera_epoch, h.frame_id): (h, frame_from_wire(h, payload)) for h, payload in frames}
    at, config = [frames[0][0].capture_ns], Config(camera=CameraConfig(check=check))
    work, bus = begun(models, config, at)
    first = next(iter(decoded.values()))[1]
    for name, T in (("tea_box", path(0.0)), ("soup_can", CAN)):
        work._tracker.correct(tracking.Correction.first(name, T, first, 1.0))
    out = []
    for header, payload in frames:
        if header.frame_id == handed_over_at:
            memory, before = work.memory(), bus.said
            work, bus = begun(models, config, at)
            work.take_over(memory, lambda *key: decoded.get(key))
            out += before
        at.append(header.capture_ns)
        bus.arriving[FrameHeader] = [(header, payload)]
        work.step()
    out += bus.said
    return {name: [p for p in out if p.object == name] for name in models}, bus.health.message().warnings


def test_with_late_depth_moving_objects_are_not_tracking_and_static_ones_are(box_and_can, sequence):
    said, warnings = played(box_and_can, sequence, late=1)
    box = said["tea_box"]
    blamed = [k for k, pose in enumerate(box) if pose.reason.startswith(LATE)]
    # From two thirds of a second on, and until it was at rest for a second.
    assert blamed[0] <= 22
    assert MOVES + 25 <= blamed[-1] < MOVES + RESTS - 1
    assert {pose.state for pose in box[blamed[0] : blamed[-1] + 1]} == {"SUSPECT"}
    assert box[-1].state == "TRACKING"
    assert {pose.state for pose in said["soup_can"]} == {"TRACKING"}
    (warning,) = warnings
    assert warning.startswith(LATE)
    assert "older than colour" in warning
    assert "camera.check" in warning


def test_a_worker_that_takes_over_keeps_the_doubt(box_and_can, sequence):
    said, warnings = played(box_and_can, sequence, late=1, handed_over_at=30)
    assert [pose.reason[: len(LATE)] for pose in said["tea_box"][29:45]] == [LATE] * 16
    assert len(warnings) == 1


def test_a_camera_without_delay_is_not_doubted(box_and_can, sequence):
    said, warnings = played(box_and_can, sequence, late=0)
    assert {pose.state for mine in said.values() for pose in mine} == {"TRACKING"}
    assert warnings == []


def test_with_the_check_off_the_delay_is_not_reported(box_and_can, sequence):
    said, warnings = played(box_and_can, sequence, late=1, check=False)
    assert not any(pose.reason.startswith(LATE) for pose in said["tea_box"])
    assert warnings == []


def test_a_new_camera_epoch_ends_the_doubt(box_and_can, sequence):
    tracker, doubt = tracking.Tracker(box_and_can), DelayDoubt(epoch=3, found=(0.033, 0.002, 0.9))
    frame = frame_from_wire(*next(sequence(0)))
    tracker.correct(tracking.Correction.first("tea_box", path(0.0), frame, 1.0))
    poses = [replace(pose, velocity=np.array([0.3, 0, 0, 0, 0, 0])) for pose in tracker.step(frame)]
    doubt.look(replace(frame, epoch=3), poses, tracker)
    assert doubt.of(poses[0]).startswith(LATE)
    doubt.look(replace(frame, epoch=4), poses, tracker)
    assert doubt.of(poses[0]) == doubt.text == ""


def test_of_several_moving_objects_one_is_measured_in_every_second_frame(box_and_can, sequence):
    """It is the one that was measured longest ago: many objects cost no more than one."""
    tracker, doubt = tracking.Tracker(box_and_can), DelayDoubt()
    frame = frame_from_wire(*next(sequence(0)))
    for name, T in (("tea_box", path(0.0)), ("soup_can", CAN)):
        tracker.correct(tracking.Correction.first(name, T, frame, 1.0))
    poses = [replace(pose, velocity=np.array([0.3, 0, 0, 0, 0, 0])) for pose in tracker.step(frame)]
    for k in range(11):
        color = frame.color.copy()
        color[0, 0] = k  # no two images are the same
        doubt.look(replace(frame, color=color, stamp_ns=frame.stamp_ns + k * 33_000_000), poses, tracker)
    assert [block.split("/")[0] for block in doubt.blocks] in (
        ["tea_box", "soup_can"] * 3,
        ["soup_can", "tea_box"] * 3,
    )


def test_images_that_come_again_and_again_are_no_evidence(box_and_can, sequence):
    """Of three images that are played in a loop, no delay can be told from a wrong registration."""
    tracker, doubt = tracking.Tracker(box_and_can), DelayDoubt()
    frames = [frame_from_wire(*sent) for _, sent in zip(range(3), sequence(1), strict=False)]
    for name, T in (("tea_box", path(0.0)), ("soup_can", CAN)):
        tracker.correct(tracking.Correction.first(name, T, frames[0], 1.0))
    poses = [replace(pose, velocity=np.array([0.3, 0, 0, 0, 0, 0])) for pose in tracker.step(frames[0])]
    for k in range(120):
        frame = replace(frames[k % 3], stamp_ns=frames[0].stamp_ns + k * 33_000_000)
        doubt.look(frame, poses, tracker)
    assert len(doubt.looks) > 50
    assert len(set(doubt.blocks)) <= 3
    assert doubt.text == ""


def test_a_memory_of_an_older_version_without_images_goes_on(box_and_can, sequence):
    tracker = tracking.Tracker(box_and_can)
    frame = frame_from_wire(*next(sequence(0)))
    tracker.correct(tracking.Correction.first("tea_box", path(0.0), frame, 1.0))
    poses = [replace(pose, velocity=np.array([0.3, 0, 0, 0, 0, 0])) for pose in tracker.step(frame)]
    old = [(300.0, 1.0, 0.0, 0.5)] * 2
    doubt = DelayDoubt(epoch=frame.epoch, looks=old, blocks=["tea_box/0 1", "tea_box/0 2"])
    for k in range(3):
        doubt.look(replace(frame, stamp_ns=frame.stamp_ns + k * 100_000_000), poses, tracker)
    assert len(doubt.looks) == len(doubt.blocks) == 5
    assert len(doubt.images) == 3
    assert len(set(doubt.blocks)) == 3
