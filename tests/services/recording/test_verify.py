"""A recording computed again is the same bit by bit; a difference is named with its frame and stage."""

import shutil
from dataclasses import replace
from itertools import count, islice

import msgspec
import numpy as np
import pytest

from huepose.model.io import model_path, save_model
from huepose.support.errors import InputError
from huepose_protos.buffers import frame_images
from huepose_protos.messages import FrameHeader, IntakeMessage, MemoryMessage, PoseMessage
from huepose_services.cli.main import main
from huepose_services.recording.read import Recording
from huepose_services.recording.verify import verify

from .conftest import NAME, STEPS, parts, tiny_frame


def _verified(path, bundles=None):
    return verify([Recording(path)], bundles)


def test_a_recording_computed_again_is_the_same_bit_by_bit(followed):
    report = _verified(followed.path)
    assert report.difference == ""
    assert (report.skipped, report.steps, report.gaps, report.unrecorded) == (1, STEPS, [], 0)
    # At 10 it says how long its poses hold from then on, at 12 until when they do.
    assert report.memories == 3
    said = [e.message for e in Recording(followed.path).events() if isinstance(e.message, PoseMessage)]
    assert report.poses == len(said) >= STEPS - 3
    assert "not checked: the first step, after which" in report.text
    assert report.without_pose == STEPS - len(said) > 0  # one object: a step gives one pose or none
    assert (
        f"{STEPS} steps of the tracker computed again, from {report.from_s:.2f} s to {report.until_s:.2f} s "
        f"of the recording, {report.without_pose} of them without a pose: {report.poses} poses and 3 "
        "recorded states of the tracker compared, the same bit by bit\n"
    ) in report.text
    few = replace(report, memories=0, poses=1, without_pose=0).text
    assert "of the recording: 1 pose compared, the same bit by bit\n" in few
    one = replace(report, steps=1, skipped=2, skipped_first=1).text
    assert one.startswith("1 step of the tracker computed again, from")
    assert "not checked: 1 step after a gap, until" in one
    # The last pose became SUSPECT when no newer frame came.
    assert [pose.state for pose in said[-2:]] == ["TRACKING", "SUSPECT"]
    assert said[-1].frame_id == said[-2].frame_id


def _change(kind, frame_id, **changes):
    """A function that changes the messages of a kind at a frame."""

    def change(event):
        message = event.message
        if isinstance(message, kind) and message.frame_id == frame_id:
            made = {name: make(message) for name, make in changes.items()}
            message = msgspec.structs.replace(message, **made)
        return type(event)(event.key, message, event.payload)

    return change


def _nudged(message):
    x, y, z = message.translation
    return float(np.nextafter(x, 1.0)), y, z


def _other_pixels(event):
    if isinstance(event.message, FrameHeader) and event.message.frame_id == 8:
        payload = bytearray(event.payload)
        middle = 640 * 3 * 240 + 3 * 320
        payload[middle - 300 : middle + 300] = bytes(600)
        return type(event)(event.key, event.message, bytes(payload))
    return event


def _other_corrections(message):
    return [msgspec.structs.replace(one, translation=_nudged(one)) for one in message.corrections]


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (
            _change(PoseMessage, 5, translation=_nudged),
            ["frame 5 of epoch", "stage publish", "tea_box/0", "translation"],
        ),
        (
            _change(PoseMessage, 5, state=lambda _: "SUSPECT"),
            ["frame 5", "publish", "SUSPECT recorded, TRACKING now"],
        ),
        (_other_pixels, ["frame 8 of epoch", "stage follow"]),
        (
            _change(IntakeMessage, 9, corrections=_other_corrections),
            ["frame 9 of epoch", "stage corrections"],
        ),
        (
            _change(IntakeMessage, 9, clock_ns=lambda m: m.clock_ns[:-1]),
            ["frame 9", "stage publish", "clock"],
        ),
    ],
)
def test_a_difference_is_named_with_its_first_frame_and_stage(followed, change, where, capsys):
    path = followed.rewritten(change)
    report = _verified(path)
    for text in where:
        assert text in report.difference
    assert main(["replay", "--verify", str(path)]) == 1
    said = capsys.readouterr()
    assert report.difference in said.out
    assert "cut off" not in said.err, "the recording is whole"


def test_recorded_states_of_the_tracker_are_compared_as_well(followed):
    memories = []

    def change(event):
        if isinstance(event.message, MemoryMessage):
            memories.append(event.message)
            if len(memories) == 2:
                plain, *own = msgspec.msgpack.decode(event.message.memory)
                other = msgspec.msgpack.encode((plain | {"_steps": 99}, *own))
                message = msgspec.structs.replace(event.message, memory=other)
                return type(event)(event.key, message)
        return event

    report = _verified(followed.rewritten(change))
    assert "stage memory" in report.difference
    assert report.memories == 0


@pytest.mark.parametrize("kind", [IntakeMessage, FrameHeader])
def test_after_a_gap_the_check_goes_on_from_the_next_recorded_state(followed, kind):
    report = _verified(
        followed.rewritten(lambda e: None if isinstance(e.message, kind) and e.message.frame_id == 5 else e)
    )
    assert report.difference == ""
    assert (len(report.gaps), report.skipped_first) == (1, 1)
    assert f"not checked: {report.skipped - 1} steps after a gap" in report.text
    assert "5 is missing" in report.gaps[0] or "step 6 is missing" in report.gaps[0]
    if kind is IntakeMessage:
        assert report.steps == 4 + (STEPS - 8) + 1
    else:
        # The next recorded state needs the frame that is missing.
        assert report.steps == 4


def test_a_tracker_that_takes_few_of_the_frames_is_computed_again(followed, tmp_path):
    """As on a busy computer: the frames between do not displace those that the tracker took."""
    out = parts(tmp_path / "slow")
    numbers = count(100_000)
    for event in Recording(followed.path).events():
        message = event.message
        if not isinstance(message, FrameHeader):
            out.message(event.key, message)
            continue
        out.frame(message, *frame_images(message, event.payload), event.key)
        for number in islice(numbers, 60):
            tiny, color, depth = tiny_frame(number)
            same = {name: getattr(message, name) for name in ("camera_epoch", "capture_ns", "publish_ns")}
            out.frame(msgspec.structs.replace(tiny, **same), color, depth, event.key)
    out.close()
    report = _verified(out.path)
    assert (report.difference, report.steps, report.gaps) == ("", STEPS, [])


def test_a_recording_that_begins_in_mid_run_says_from_when_it_is_checked_and_why(followed, printed):
    """The frames that the tracker had kept before the recording began are not in it."""
    memories = []

    def change(event):
        if isinstance(event.message, MemoryMessage):
            memories.append(event.message)
            if len(memories) == 1:
                message = msgspec.structs.replace(event.message, frames=[(1, 1)])
                return type(event)(event.key, message)
        return event

    path = followed.rewritten(change)
    report = _verified(path)
    assert report.difference == ""
    assert report.skipped == report.skipped_first == STEPS + 1 - report.steps > 1
    assert 0.0 < report.from_s < report.until_s
    out = printed(["replay", "--verify", path])
    assert f"from {report.from_s:.2f} s to {report.until_s:.2f} s" in out
    assert (
        f"not checked: the {report.skipped_first} steps before {report.from_s:.2f} s. The tracker ran" in out
    )
    assert "after a gap" not in out


def test_poses_that_were_not_recorded_are_counted(followed):
    report = _verified(
        followed.rewritten(
            lambda e: None if isinstance(e.message, PoseMessage) and e.message.frame_id == 5 else e
        )
    )
    assert (report.difference, report.unrecorded, report.steps) == ("", 1, STEPS)
    assert f" {report.poses} poses and 3 recorded states of the tracker compared, the same" in report.text
    assert report.text.endswith("\nnot compared: 1 pose that the recording lacks")


def test_jpeg_cannot_be_verified(followed):
    with pytest.raises(InputError, match="Record without --jpeg"):
        _verified(followed.rewritten(lambda e: e, jpeg=True))


def test_a_recording_without_images_is_not_refused_as_jpeg(followed):
    def without_frames(event):
        return None if isinstance(event.message, FrameHeader) else event

    report = _verified(followed.rewritten(without_frames, jpeg=True))
    assert report == _verified(followed.rewritten(without_frames))
    assert (report.steps, report.difference) == (0, "")


def test_other_reference_models_are_refused(followed, tmp_path):
    other = tmp_path / "bundles"
    shutil.copytree(followed.bundles, other)
    assert _verified(followed.path, other).difference == ""
    content = bytearray(model_path(other, NAME).read_bytes())
    model_path(other, NAME).write_bytes(bytes(content) + b" ")
    with pytest.raises(InputError, match=r"reference model tea_box.*--bundles"):
        _verified(followed.path, other)


@pytest.fixture
def other_bundles(tea_box, tmp_path):
    """A model of the same name that is a little larger."""
    mesh = replace(tea_box.mesh, vertices=tea_box.mesh.vertices * np.float32(1.05))
    save_model(replace(tea_box, mesh=mesh), model_path(tmp_path / "other", NAME))
    return tmp_path / "other"


def test_a_folder_without_the_model_is_refused_with_what_to_do(followed, tmp_path, refused):
    said = refused(["replay", "--verify", followed.path, "--bundles", tmp_path])
    assert f"{tmp_path}/tea_box.huepose: found no such file; expected the reference model tea_box." in said
    assert "Give the folder of the models that it was recorded with: --bundles DIR." in said


def test_if_models_were_not_noted_a_difference_says_that_they_may_differ(followed, other_bundles):
    path = followed.rewritten(lambda e: e, noted=False)
    assert _verified(path).difference == ""
    difference = _verified(path, other_bundles).difference
    assert "does not say which reference models it used: where tea_box may be another one" in difference
    assert "give the folder of the models that it was recorded with: --bundles DIR" in difference


def test_another_model_that_is_noted_later_is_refused(followed, other_bundles):
    """As the model of an object that was added during the recording."""
    path = followed.rewritten(lambda e: e, noted=False, noted_last=True)
    assert _verified(path).difference == ""
    with pytest.raises(InputError, match=r"reference model tea_box: .*--bundles DIR"):
        _verified(path, other_bundles)


def test_a_recording_without_frames_has_nothing_to_verify(followed, capsys):
    path = followed.rewritten(lambda e: e if isinstance(e.message, PoseMessage) else None)
    assert main(["replay", "--verify", str(path)]) == 1
    out = capsys.readouterr().out
    assert out.startswith("nothing to compare: no step of the tracker is in it. Record while")
    assert "same" not in out


def test_a_recording_without_a_recorded_state_says_to_record_for_longer(followed, capsys):
    path = followed.rewritten(lambda e: None if isinstance(e.message, MemoryMessage) else e)
    assert main(["replay", "--verify", str(path)]) == 1
    assert capsys.readouterr().out.startswith("nothing to compare: record for longer than ten seconds")
