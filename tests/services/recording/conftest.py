"""A recording of a tracker worker that tracks a box, made in this process; and frames of a few pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from huepose.geometry import se3
from huepose.model.io import model_path, save_model
from huepose_protos.buffers import frame_images, pack
from huepose_protos.examples import example
from huepose_protos.messages import CorrectionMessage, FrameHeader, IntakeMessage, PoseMessage
from huepose_services import models
from huepose_services.convert import pose_to_wire
from huepose_services.recording.parts import Limits, Parts
from huepose_services.recording.read import Event, Recording
from huepose_services.recording.verify import ReplayBus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config, TrackerConfig
from huepose_services.tracker import TrackerWork, tracker_of
from tests.services.fake_bus import sent

KEY = "huepose/a/cam0/"
UNIX_NS = 1_700_000_000_000_000_000
NAME, STEPS = "tea_box", 14
FRAME = example(FrameHeader)


def tiny_frame(number):
    """Header, colour and depth of a frame of 6 x 4 pixels."""
    rng = np.random.default_rng(number)
    color = rng.integers(0, 255, (4, 6, 3), dtype=np.uint8)
    depth = rng.integers(0, 65535, (4, 6), dtype=np.uint16)
    size = msgspec.structs.replace(FRAME.intrinsics, width=6, height=4)
    specs, payload = pack({"color": color, "depth": depth})
    stamp_ns = 10**9 + number * 33_333_333
    stamps = {"capture_ns": stamp_ns, "publish_ns": stamp_ns + 5_000_000}
    header = msgspec.structs.replace(FRAME, frame_id=number, intrinsics=size, buffers=specs, **stamps)
    assert frame_images(header, payload)[0].shape == (4, 6, 3)
    return header, color, depth


def parts(path, limits=None, jpeg=False, **about):
    """A recording that has begun."""
    return Parts(path, limits or Limits(2**40, None, 0), UNIX_NS, {"site": "a"} | about, jpeg)


class _Clock:
    """A clock that advances by a microsecond with each reading, and as a test sets it."""

    def __init__(self):
        self.now_ns = now_ns()

    def __call__(self):
        self.now_ns += 1000
        return self.now_ns


class _Bus(ReplayBus):
    """Keeps what the worker publishes, in order."""

    def put(self, key, message):
        super().put(key, message)
        self.said.append((KEY + f"pose/{message.object}/{message.instance}", message))

    def put_aside(self, key, message):
        kind = "intake" if isinstance(message, IntakeMessage) else "memory"
        self.said.append((KEY + f"tracker/{kind}", message))


@dataclass
class Followed:
    """The recording, the folder of the model, and a function that writes it again with changes."""

    path: Path
    bundles: Path
    folder: Path

    def rewritten(
        self, change: Callable[[Event], Event | None], noted: bool = True, noted_last: bool = False, **options
    ) -> Path:
        """The path of another recording, with what `change` makes of each event; None leaves it out. noted,
        noted_last: whether it says at its beginning, and at its end, which models were used."""
        recording, out = Recording(self.path), None
        path = self.folder / f"{len(list(self.folder.iterdir()))}.mcap"
        for event in recording.events():
            if out is None:
                out = parts(path, **options)
                out.note("models", recording.notes["models"] if noted else {})
            event = change(event)
            if event is not None and isinstance(event.message, FrameHeader):
                out.frame(event.message, *frame_images(event.message, event.payload), event.key)
            elif event is not None:
                out.message(event.key, event.message)
        out.note("models", recording.notes["models"] if noted_last else {})
        out.close()
        return path


@pytest.fixture(scope="session")
def followed(tea_box, take_picture, standing, tmp_path_factory):
    """14 frames of a tracked box, with a correction of each kind: acquire, agree, correct."""
    folder = tmp_path_factory.mktemp("followed")
    bundles = folder / "bundles"
    save_model(tea_box, model_path(bundles, NAME))
    config = Config(bundles=str(bundles), tracker=TrackerConfig(max_age_ms=10_000.0))
    tracker = tracker_of(config, models.load(config))
    bus = _Bus()
    clock = _Clock()
    work = TrackerWork(bus, tracker, bus, config, clock)
    (folder / "recordings").mkdir()
    path = folder / "recordings" / "0.mcap"
    out = parts(path)
    out.note("models", models.digests(config, [NAME]))
    before = None
    for number in range(STEPS):
        T = se3.perturb(standing, np.array([0.004 * number, 0.0, 0.0, 0.0, 0.01 * number, 0.0]))
        clock.now_ns += 33_333_333
        stamp_ns = clock.now_ns
        stamps = {"frame_id": number, "capture_ns": stamp_ns, "publish_ns": stamp_ns}
        header, payload = sent(take_picture([(tea_box.mesh, T)]), **stamps)
        out.frame(header, *frame_images(header, payload), KEY + "frame")
        corrections = []
        if number in (3, 6, 9):
            # About the previous frame.
            verdict = {3: "acquire", 6: "agree", 9: "correct"}[number]
            nearly = se3.perturb(before[1], np.full(6, 0.003 if verdict == "correct" else 0.0))
            translation, quaternion = pose_to_wire(nearly)
            corrections.append(
                CorrectionMessage(
                    **{"publish_ns": stamp_ns, "object": NAME, "instance": 0, "quality": 0.96},
                    **{"camera_epoch": header.camera_epoch, "frame_id": before[0].frame_id},
                    **{"capture_ns": before[0].capture_ns, "translation": translation},
                    **{"quaternion": quaternion, "verdict": verdict, "seq": number},
                )
            )
        before = (header, T)
        bus.said = []
        if number == 10:
            fresh = msgspec.structs.replace(config.tracker, max_age_ms=9_000.0)
            work.reload(msgspec.structs.replace(config, tracker=fresh))
        bus.give(
            msgspec.structs.replace(example(IntakeMessage), corrections=corrections), (header, payload), []
        )
        work._memory_due_ns = 0 if number in (0, 7, 12) else 2**62
        work.step()
        for key, message in bus.said:
            out.message(key, message)
    # Then no frame comes for so long that the last pose becomes SUSPECT.
    clock.now_ns += 11_000_000_000
    bus.said = []
    bus.give(msgspec.structs.replace(example(IntakeMessage), corrections=[]), None, [])
    work.step()
    for key, message in bus.said:
        out.message(key, message)
    out.close()
    return Followed(path, bundles, folder / "recordings")


def written(path, numbers=(7, 8, 12), jpeg=False, chunks=False):
    """A recording of frames with a pose after each."""
    out = parts(path, jpeg=jpeg)
    for number in numbers:
        header, color, depth = tiny_frame(number)
        out.frame(header, color, depth, KEY + "frame")
        pose = msgspec.structs.replace(
            example(PoseMessage), frame_id=number, publish_ns=header.publish_ns + 1
        )
        out.message(KEY + "pose/x/1", pose)
        if chunks:
            out._due = 0.0
            out.commit()
    out.close()
    return out


def frames(events):
    """Header, colour and depth of each frame."""
    return [
        (e.message, *frame_images(e.message, e.payload)) for e in events if isinstance(e.message, FrameHeader)
    ]


def mcap_of(path, **message):
    """A file with one message of another program."""
    message = {"topic": KEY + "pose/x/1", "encoding": "json", "data": b"{}"} | message
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(message["topic"], message["encoding"], 0)
        writer.add_message(channel, 1, message["data"], 1)
        writer.finish()
    return path


def chunks_of(path):
    """The index of the file's chunks."""
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes
