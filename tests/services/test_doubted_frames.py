"""If a whole image or the camera is wrong, no pose is TRACKING, and the reason is given."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from huepose import tracking
from huepose.tracking.types import Applied
from huepose_protos.messages import CorrectionMessage, FrameHeader
from huepose_services.convert import frame_from_wire
from huepose_services.doubts import DISAGREES, RELIT
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.tracker import TrackerWork
from tests.conftest import standing_pose
from tests.onboarded import onboarded
from tests.onboarding import solids
from tests.services.fake_bus import sent
from tests.services.tracker_work import (
    CORRECTION,
    MS,
    BusStandIn,
    Loser,
    ObjectsStandIn,
    changed_frame,
    frame_at,
    frame_of_age,
    worker,
)

WARM = (1.15, 1.0, 0.6)


def said_of(work, bus, frame, **changes):
    """State and reason that are published about a frame (header, payload) with these changes."""
    header, payload = frame
    bus.arriving[FrameHeader] = [(msgspec.structs.replace(header, **changes), payload)]
    work.step()
    return bus.said[-1].state, bus.said[-1].reason


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"color": 1, "depth": -1}, "no depth in the whole image"),
        ({"depth": 1}, "colour image stays the same"),
        ({"color": 1, "depth": 1, "cx": 33.0}, "intrinsics changed"),
    ],
)
def test_a_wrong_frame_gives_no_tracking_pose_and_health_says_why(bad, reason):
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [changed_frame(1), changed_frame(2, **bad)]
    work.step()
    assert bus.health.message().warnings == []
    work.step()
    assert [p.state for p in bus.said] == ["TRACKING", "SUSPECT"]
    (warning,) = bus.health.message().warnings
    assert reason in warning
    intrinsics = {"cx": bad["cx"]} if "cx" in bad else {}
    bus.arriving[FrameHeader] = [changed_frame(3, color=2, depth=2, **intrinsics)]
    work.step()
    assert bus.said[-1].state == "TRACKING"
    assert bus.health.message().warnings == []


def test_a_camera_that_states_another_focal_length_is_doubted_until_it_states_the_first_again():
    """Also in a new epoch, and for poses that perception adds between two frames: with wrong intrinsics a
    pose may fit and still be wrong."""
    work, bus, _ = worker()
    header, payload = changed_frame(1)
    fx = header.intrinsics.fx
    bus.arriving[FrameHeader] = [
        (header, payload),
        changed_frame(2, 1, 1, fx=1.5 * fx),
        changed_frame(3, 2, 2, fx=1.5 * fx),
    ]
    for _ in range(3):
        work.step()
    header, payload = changed_frame(4, 3, 3, fx=1.5 * fx)
    said_of(work, bus, (header, payload), camera_epoch=header.camera_epoch + 1)
    work._publish_all(work._tracker.poses(), header, None)
    focused, back = changed_frame(5, 4, 4, fx=1.04 * fx), changed_frame(6, 5, 5, fx=1.04 * fx)
    bus.arriving[FrameHeader] = [focused, back]
    for _ in range(2):
        work.step()
    states = [p.state for p in bus.said]
    assert set(states[1:-2]) == {"SUSPECT"}
    assert (states[0], *states[-2:]) == ("TRACKING",) * 3
    assert any("restart the tracker" in p.reason for p in bus.said)


def test_no_pose_is_tracking_while_perception_reports_a_fault_of_the_camera():
    """Until perception withdraws it, or the camera is opened again."""
    work, bus, _ = worker()
    epoch, seq = changed_frame(1)[0].camera_epoch, iter(range(1, 9))

    def after(frame, camera=None, epoch=epoch):
        if camera is not None:
            bus.arriving[CorrectionMessage] = [
                msgspec.structs.replace(
                    CORRECTION, camera_epoch=epoch, camera=camera, seq=CORRECTION.seq + next(seq)
                )
            ]
        return said_of(work, bus, changed_frame(frame, frame, frame), camera_epoch=epoch)

    said = "The image shows objects 10 % larger."
    assert after(1)[0] == "TRACKING"
    assert [after(2, said), after(3), after(4, said)] == [("SUSPECT", said)] * 3
    assert after(5, "")[0] == "TRACKING"
    assert [after(6, said)[0], after(7, epoch=epoch + 1)[0]] == ["SUSPECT", "TRACKING"]


def test_a_late_correction_of_an_older_camera_epoch_withdraws_nothing():
    work, bus, _ = worker()
    present = msgspec.structs.replace(
        CORRECTION, camera_epoch=frame_of_age(1, 0.0)[0].camera_epoch, camera="Blue for red."
    )
    late = msgspec.structs.replace(present, camera_epoch=present.camera_epoch - 1, camera="")
    for number, (message, answer) in enumerate([(present, Applied.APPLIED), (late, Applied.REFUSED_EPOCH)]):
        work._tracker.answer = answer
        bus.arriving[CorrectionMessage] = [message]
        assert said_of(work, bus, changed_frame(number + 1, number + 1)) == ("SUSPECT", "Blue for red.")


def test_only_the_object_that_perception_doubts_is_not_tracking():
    """Until perception withdraws it, or the camera is opened again; if it is lost, that is the reason."""
    work, bus, _ = worker()
    tracker = work._tracker
    epoch, seq = changed_frame(1)[0].camera_epoch, iter(range(1, 9))

    def after(frame, name="", reason="", epoch=epoch):
        if name:
            changes = {"object": name, "instance": 0, "reason": reason, "seq": CORRECTION.seq + next(seq)}
            correction = msgspec.structs.replace(CORRECTION, camera_epoch=epoch, **changes)
            bus.arriving[CorrectionMessage] = [correction]
        return said_of(work, bus, changed_frame(frame, frame, frame), camera_epoch=epoch)

    said = "The image shows it about 12 % larger than its mesh."
    assert after(1, "cup", said) == ("TRACKING", "")
    assert [after(2, "mug", said), after(3), after(4, "cup", "")] == [("SUSPECT", said)] * 3
    assert after(5, "mug", "") == ("TRACKING", "")
    assert after(6, "mug", said)[0] == "SUSPECT"
    tracker.step = Loser(tracker.T_cam_obj).step
    state, reason = after(7)
    assert (state, bool(reason), reason == said) == ("LOST", True, False)
    del tracker.step
    assert after(8, epoch=epoch + 1)[0] == "TRACKING"


def test_a_worker_that_takes_over_knows_what_perception_doubts(part, light_changes):
    frames = list(light_changes(False))[:4]
    decoded = {(h.camera_epoch, h.frame_id): (h, frame_from_wire(h, payload)) for h, payload in frames}
    at, said, published = [], "The image shows it about 12 % larger than its mesh.", []

    def begun():
        tracker = tracking.Tracker({"part": part[1]})
        return TrackerWork(BusStandIn(), tracker, ObjectsStandIn(), Config(), lambda: at[-1].capture_ns)

    work = begun()
    first = next(iter(decoded.values()))[1]
    work._tracker.correct(tracking.Correction.first("part", standing_pose(0.6, 0.0, 0.0), first, 1.0))
    changes = {"object": "part", "instance": 0, "camera_epoch": first.epoch, "reason": said}
    work._own.against.hear(msgspec.structs.replace(CORRECTION, **changes))
    for header, payload in frames:
        at.append(header)
        work._bus.arriving[FrameHeader] = [(header, payload)]
        work.step()
        published += [(p.state, p.reason) for p in work._bus.said]
        memory, work = work.memory(), begun()
        work.take_over(memory, lambda *key: decoded.get(key))
    assert published == [("SUSPECT", said)] * 4


def test_no_pose_is_tracking_while_a_frame_says_that_its_camera_has_stopped():
    work, bus, _ = worker()
    said = "cam.py: its image has changed before"
    frames = [changed_frame(number + 1, number // 3, number // 3) for number in range(4)]
    cameras = ["", said, said, ""]
    published = [said_of(work, bus, frame, camera=c) for frame, c in zip(frames, cameras, strict=True)]
    assert published == [("TRACKING", ""), ("SUSPECT", said), ("SUSPECT", said), ("TRACKING", "")]


def test_a_fault_of_the_image_is_the_reason_of_a_suspect_pose_and_makes_none_suspect():
    work, bus, _ = worker()
    said = "cam.py: depth looks like millimetres"
    # The second has no depth at all, which the tracker notices itself.
    frames = changed_frame(1), changed_frame(2, 1, -1), changed_frame(3, 2, 2)
    published = [said_of(work, bus, frame, picture=said) for frame in frames]
    assert published == [("TRACKING", ""), ("SUSPECT", said), ("TRACKING", "")]


def test_in_a_new_camera_epoch_poses_of_the_old_one_become_suspect():
    work, bus, _ = worker()
    bus.arriving[FrameHeader] = [frame_of_age(1, 0.0)]
    work.step()
    header, payload = frame_of_age(2, 0.0)
    work._tracker.step = lambda frame: []
    said_of(work, bus, (header, payload), camera_epoch=header.camera_epoch + 1)
    assert [(p.state, p.camera_epoch) for p in bus.said] == [
        ("TRACKING", header.camera_epoch),
        ("SUSPECT", header.camera_epoch),
    ]


@pytest.mark.parametrize(
    ("times", "reason"),
    [(1, "It is not visible where it was"), (1000, "away or farther"), (0.005, "nearer than 0.0")],
)
def test_if_all_is_lost_and_depth_may_be_of_another_unit_that_is_the_reason(times, reason):
    work, bus, _ = worker(None)
    work._tracker = Loser(None)
    bus.arriving[FrameHeader] = [frame_at(1.0 * times)]
    work.step()
    (pose,) = bus.said
    assert pose.state == "LOST"
    assert reason in pose.reason
    assert ("depth scale" in pose.reason) == (times != 1)


@pytest.fixture(scope="module")
def part():
    """Mesh and reference model of a box of one colour."""
    mesh = solids.box((0.09, 0.06, 0.15))
    mesh = replace(mesh, texture=np.full_like(mesh.texture, (200, 110, 40)))
    return mesh, onboarded(mesh, "part", plain=True)


@pytest.fixture
def light_changes(part, take_picture):
    """Headers and payloads of a part that moves slowly. In the sixth frame the light changes from warm to
    neutral; or else the part is replaced by a thing that looks as the part would in the neutral light."""

    def shown(relit):
        mesh, rng, begun_ns = part[0], np.random.default_rng(0), now_ns()
        other = replace(mesh, texture=(mesh.texture / WARM).clip(0, 255).astype(np.uint8))
        for k in range(10):
            before = k < 5
            thing = (mesh if before or relit else other, standing_pose(0.6, 0.001 * k, 0.0))
            seen = take_picture([thing], WARM if before or not relit else (1.0, 1.0, 1.0))
            noisy = (seen.color + rng.normal(0.0, 2.0, seen.color.shape)).clip(0, 255).astype(np.uint8)
            yield sent(replace(seen, color=noisy), frame_id=k, capture_ns=begun_ns + k * 33 * MS)

    return shown


@pytest.mark.parametrize("relit", [True, False])
def test_a_pose_that_is_suspect_after_a_change_of_light_gives_the_reason(part, light_changes, relit):
    frames = {(h.camera_epoch, h.frame_id): (h, payload) for h, payload in light_changes(relit)}
    decoded = {number: (h, frame_from_wire(h, payload)) for number, (h, payload) in frames.items()}
    at = []

    def begun():
        tracker = tracking.Tracker({"part": part[1]})
        work = TrackerWork(BusStandIn(), tracker, ObjectsStandIn(), Config(), lambda: at[-1].capture_ns)
        return work, work._bus

    work, bus = begun()
    first = tracking.Correction.first(
        "part", standing_pose(0.6, 0.0, 0.0), next(iter(decoded.values()))[1], 1.0
    )
    work._tracker.correct(first)
    for header, payload in frames.values():
        at.append(header)
        if header.frame_id == 7:  # another worker takes over
            memory, out = work.memory(), bus.said
            work, bus = begun()
            work.take_over(memory, lambda *key: decoded.get(key))
            bus.said = out
        bus.arriving[FrameHeader] = [(header, payload)]
        work.step()
    assert [p.state for p in bus.said[:5]] == ["TRACKING"] * 5
    doubted = [p.reason for p in bus.said[5:] if p.state != "TRACKING"]
    assert 3 <= len(doubted) < 5
    assert set(doubted) == {RELIT if relit else DISAGREES}
    assert bus.said[-1].state == "TRACKING"
