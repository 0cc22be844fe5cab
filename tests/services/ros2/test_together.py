"""The poses of a frame are told together, however they are spread, and nobody waits for long."""

from __future__ import annotations

from typing import Any

import msgspec

from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from huepose_services.ros2.together import Together

MS, FRAME_NS = 1_000_000, 33_000_000
GONE = {"translation": None, "quaternion": None, "covariance": None, "state": "LOST"}


def said(frame: int, name: str, **changes: Any) -> PoseMessage:
    about = {"state": "TRACKING", "reason": "", "frame_id": frame, "capture_ns": frame * FRAME_NS, **changes}
    return msgspec.structs.replace(example(PoseMessage), object=name, **about)


def run(*poses: tuple[int, PoseMessage]) -> list[tuple[int, int, list[str]]]:
    """When what was told of which frame, of poses that come at these times in ms."""
    together, told = Together(), []

    def tell(at_ns: int) -> None:
        found = together.take()
        told.append((at_ns // MS, found[0].frame_id, [pose.object for pose in found]))

    for at_ms, pose in poses:
        due_ns = together.due_ns
        if due_ns is not None and due_ns < at_ms * MS:
            tell(due_ns)
        if together.ends_with(pose):
            tell(at_ms * MS)
        together.add(pose, at_ms * MS)
        if together.complete:
            tell(at_ms * MS)
    if together.due_ns is not None:
        tell(together.due_ns)
    return told


def test_a_frame_is_told_once_however_far_its_poses_are_apart_and_at_once_when_all_are_there() -> None:
    names = ("box", "can", "jar")
    poses = [(40 * k + 12 * n, said(k, name)) for k in range(4) for n, name in enumerate(names)]
    told = run(*poses)
    # Of the first frame nobody knows how many there are.
    assert told[0] == (40, 0, list(names))
    assert told[1:] == [(40 * k + 24, k, list(names)) for k in (1, 2, 3)]


def test_what_is_lost_was_heard_of_and_is_not_waited_for() -> None:
    told = run(
        (0, said(0, "box")),
        (1, said(0, "can")),
        (40, said(1, "can", **GONE)),
        (43, said(1, "box")),
        (80, said(2, "box")),
        (81, said(2, "can", **GONE)),
    )
    assert told[1:] == [(43, 1, ["box"]), (81, 2, ["box"])]


def test_who_is_silent_is_waited_for_shortly_and_after_a_second_no_longer() -> None:
    first = [(0, said(0, "box")), (0, said(0, "can"))]
    told = run(*first, *((50 * k, said(k, "box")) for k in range(1, 40)))
    late = {frame: at - 50 * frame for at, frame, _ in told}
    assert set(late) == set(range(40))
    assert {late[k] for k in range(1, 30)} == {25}
    assert {late[k] for k in range(32, 40)} == {0}, "a second of frames after it spoke"


def test_poses_that_never_end_are_told_after_a_tenth_of_a_second() -> None:
    told = run(*((20 * k, said(0, f"box{k:02}")) for k in range(12)))
    assert [at for at, _, _ in told] == [100, 220]
    assert (len(told[0][2]), len(told[1][2])) == (6, 12), "again with all of it"


def test_who_is_found_between_two_frames_comes_after_them_in_a_message_that_has_all() -> None:
    told = run((0, said(0, "box")), (40, said(1, "box")), (50, said(1, "can")), (80, said(2, "box")))
    assert told[1:3] == [(40, 1, ["box"]), (75, 1, ["box", "can"])]


def test_what_is_taken_back_is_not_told_again() -> None:
    doubted = said(1, "box", state="SUSPECT", reason="No new frame came.")
    assert run((0, said(1, "box")), (5, doubted)) == []
    assert run((0, said(1, "box")), (200, doubted)) == [(25, 1, ["box"])]


def test_another_opening_of_the_camera_begins_anew() -> None:
    told = run(
        (0, said(9, "box")),
        (40, said(10, "box")),
        (80, said(0, "can", camera_epoch=5)),
        (120, said(1, "can", camera_epoch=5)),
    )
    assert told[1:] == [(40, 10, ["box"]), (105, 0, ["can"]), (120, 1, ["can"])]
