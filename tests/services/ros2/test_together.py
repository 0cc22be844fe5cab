"""The poses of a frame are sent together, however they are spread in time, and without a long wait."""

from __future__ import annotations

from typing import Any

import msgspec

from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from huepose_services.ros2.together import Together

MS, FRAME_NS = 1_000_000, 33_000_000
GONE = {"translation": None, "quaternion": None, "covariance": None, "state": "LOST"}


def message(frame: int, name: str, **changes: Any) -> PoseMessage:
    about = {"state": "TRACKING", "reason": "", "frame_id": frame, "capture_ns": frame * FRAME_NS, **changes}
    return msgspec.structs.replace(example(PoseMessage), object=name, **about)


def run(*poses: tuple[int, PoseMessage]) -> list[tuple[int, int, list[str]]]:
    """Time in ms, frame and objects of all that is sent, for poses that come at these times in ms."""
    together, sent = Together(), []

    def send(at_ns: int) -> None:
        found = together.take()
        sent.append((at_ns // MS, found[0].frame_id, [pose.object for pose in found]))

    for at_ms, pose in poses:
        due_ns = together.due_ns
        if due_ns is not None and due_ns < at_ms * MS:
            send(due_ns)
        if together.ends_with(pose):
            send(at_ms * MS)
        together.add(pose, at_ms * MS)
        if together.complete:
            send(at_ms * MS)
    if together.due_ns is not None:
        send(together.due_ns)
    return sent


def test_a_frame_is_sent_once_and_as_soon_as_all_its_poses_are_there() -> None:
    names = ("box", "can", "jar")
    poses = [(40 * k + 12 * n, message(k, name)) for k in range(4) for n, name in enumerate(names)]
    sent = run(*poses)
    # At the first frame the number of objects is not known.
    assert sent[0] == (40, 0, list(names))
    assert sent[1:] == [(40 * k + 24, k, list(names)) for k in (1, 2, 3)]


def test_a_lost_object_is_not_waited_for() -> None:
    sent = run(
        (0, message(0, "box")),
        (1, message(0, "can")),
        (40, message(1, "can", **GONE)),
        (43, message(1, "box")),
        (80, message(2, "box")),
        (81, message(2, "can", **GONE)),
    )
    assert sent[1:] == [(43, 1, ["box"]), (81, 2, ["box"])]


def test_a_missing_object_is_waited_for_shortly_and_after_a_second_no_longer() -> None:
    first = [(0, message(0, "box")), (0, message(0, "can"))]
    sent = run(*first, *((50 * k, message(k, "box")) for k in range(1, 40)))
    late = {frame: at - 50 * frame for at, frame, _ in sent}
    assert set(late) == set(range(40))
    assert {late[k] for k in range(1, 30)} == {25}
    assert {late[k] for k in range(32, 40)} == {0}, "a second of frames after its last pose"


def test_a_frame_whose_poses_never_end_is_sent_after_a_tenth_of_a_second() -> None:
    sent = run(*((20 * k, message(0, f"box{k:02}")) for k in range(12)))
    assert [at for at, _, _ in sent] == [100, 220]
    assert (len(sent[0][2]), len(sent[1][2])) == (6, 12), "again with all its poses"


def test_after_a_late_pose_the_frame_is_sent_again_with_all_poses() -> None:
    sent = run(
        (0, message(0, "box")), (40, message(1, "box")), (50, message(1, "can")), (80, message(2, "box"))
    )
    assert sent[1:3] == [(40, 1, ["box"]), (75, 1, ["box", "can"])]


def test_a_pose_that_becomes_suspect_later_is_not_sent_again() -> None:
    suspect = message(1, "box", state="SUSPECT", reason="No new frame came.")
    assert run((0, message(1, "box")), (5, suspect)) == []
    assert run((0, message(1, "box")), (200, suspect)) == [(25, 1, ["box"])]


def test_another_camera_epoch_begins_anew() -> None:
    sent = run(
        (0, message(9, "box")),
        (40, message(10, "box")),
        (80, message(0, "can", camera_epoch=5)),
        (120, message(1, "can", camera_epoch=5)),
    )
    assert sent[1:] == [(40, 10, ["box"]), (105, 0, ["can"]), (120, 1, ["can"])]
