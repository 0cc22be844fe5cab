"""An intruder on the bus: it sends received messages again, late, twice or as another camera's, and messages
that no reader can decode, on every key.

Only a program of the same user can do this; it does what a broken worker could do.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle
from typing import Any

import msgspec
import numpy as np
import zenoh

from huepose_protos import encode
from huepose_protos.buffers import frame_images, pack
from huepose_protos.codec import decode
from huepose_protos.examples import images, messages
from huepose_protos.keys import Keys
from huepose_protos.messages import (
    CorrectionMessage,
    DetectedObject,
    FrameHeader,
    MaskedObject,
    MaskRuns,
    Masks,
    Message,
    RequestedObject,
)
from huepose_services.chaos.system import LivePipeline
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.session import open_reader_session, zenoh_config

Frame = tuple[FrameHeader, bytes]
_KEPT = 30


@contextmanager
def repeating(
    system: LivePipeline, rate_hz: float, send: Callable[[zenoh.Session, deque[Frame]], None]
) -> Iterator[None]:
    """A session that keeps the last second of frames, and calls `send` with them at rate_hz."""
    session = open_reader_session(system.endpoints)
    frames: deque[Frame] = deque(maxlen=_KEPT)

    def hear(sample: zenoh.Sample) -> None:
        if sample.attachment is not None:
            header = decode(sample.attachment.to_bytes(), FrameHeader)
            if header.camera_epoch in system.epochs:
                frames.append((header, sample.payload.to_bytes()))

    stopping = threading.Event()

    def work() -> None:
        while not stopping.wait(1.0 / rate_hz):
            if len(frames) == _KEPT:
                send(session, frames)

    session.declare_subscriber(system.pipeline.key("frame"), hear)
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join(2.0)
        session.close()


def send_old_frames(session: zenoh.Session, frames: deque[Frame], key: str) -> None:
    """Send a frame of half a second ago, and the newest a second time."""
    for header, payload in (frames[_KEPT // 2], frames[-1]):
        session.put(key, payload, attachment=encode(header), congestion_control=zenoh.CongestionControl.DROP)


def send_frames_of_another_camera(session: zenoh.Session, frames: deque[Frame], key: str) -> None:
    """Send the newest frame, mirrored, as if a second camera had captured it."""
    header, payload = frames[-1]
    color, depth = frame_images(header, payload)
    _, mirrored = pack({"color": np.fliplr(color), "depth": np.fliplr(depth)})
    foreign = msgspec.structs.replace(header, camera_epoch=7, publish_ns=now_ns())
    session.put(key, mirrored, attachment=encode(foreign), congestion_control=zenoh.CongestionControl.DROP)


def send_bad_masks(session: zenoh.Session, frames: deque[Frame], key: str, name: str) -> None:
    """Send a mask without a pixel, and one of another size than the frame's."""
    header, payload = frames[-1]
    i = header.intrinsics
    empty = MaskRuns(width=i.width, height=i.height, runs=[i.width * i.height])
    other = MaskRuns(width=7, height=5, runs=[0, 35])
    wanted = DetectedObject(
        request=RequestedObject(object=name, instance=None), box=(10.0, 10.0, 200.0, 200.0), score=1.0
    )
    for mask in (empty, other):
        message = Masks(
            publish_ns=now_ns(),
            request_seq=0,
            request_ns=now_ns(),
            frame=header,
            objects=[MaskedObject(detection=wanted, masks=[mask])],
        )
        session.put(key, payload, attachment=encode(message))


def send_late_corrections(
    session: zenoh.Session, corrections: deque[CorrectionMessage], key: str, older_than_s: float
) -> None:
    """Send corrections of long ago with new numbers, and 0.3 m beside the right position."""
    old = [c for c in list(corrections) if now_ns() - c.capture_ns > older_than_s * 1e9]
    for correction in old[-3:]:
        x, y, z = correction.translation
        moved = msgspec.structs.replace(correction, seq=now_ns(), translation=(x + 0.3, y, z))
        session.put(key, encode(moved))


@contextmanager
def slow_reader(system: LivePipeline, delay_s: float) -> Iterator[list[str]]:
    """A subscriber that takes delay_s for each frame and each pose."""
    with open_reader_session(system.endpoints) as session:
        for tail in ("frame", "pose/**"):
            session.declare_subscriber(system.pipeline.key(tail), lambda sample: time.sleep(delay_s))
        yield []


@contextmanager
def hoarder(system: LivePipeline) -> Iterator[list[str]]:
    """A reader by shared memory that never releases a frame, so that the camera's pool has no room left."""
    kept: list[Any] = []
    with zenoh.open(zenoh_config([], [system.endpoints[0]], shared_memory=True)) as session:
        # Two hundred frames are more than any pool holds, but do not fill this computer's memory.
        session.declare_subscriber(
            system.pipeline.key("frame"), lambda sample: kept.append(sample) if len(kept) < 200 else None
        )
        try:
            yield []
        finally:
            kept.clear()


_OVER_EVERY_CAP = 2 * 1024 * 1024


def bad_bytes(good: bytes) -> list[bytes]:
    """Variants of the bytes of a message that are wrong: none may be decoded."""
    tree = msgspec.msgpack.decode(good)
    nan, infinite = float("nan"), float("inf")
    reflected = [0.5, 0.5, 0.5, 0.6]  # no unit quaternion: not the rotation of a rigid body
    changes: list[object] = [
        {**tree, "version": "9.0"},
        {**tree, "publish_ns": "soon"},
        {**tree, "publish_ns": -1},
        [tree],
        {},
        7,
    ]
    changes += [
        {**tree, name: value}
        for name, value in (
            ("translation", [nan, 0.0, 1.0]),
            ("translation", [infinite, 0.0, 1.0]),
            ("quaternion", reflected),
            ("quaternion", [0.0, 0.0, 0.0, 0.0]),
            ("covariance", [nan] * 36),
            ("objects", "all"),
            ("estimates", [{}]),
            ("intrinsics", {"fx": nan}),
            ("state", "FOUND"),
            ("camera_epoch", "7"),
        )
        if name in tree
    ]
    changed = [msgspec.msgpack.encode(change) for change in changes]
    return [b"", b"\xc1", b"\xff" * 100, good[:-1], good[: len(good) // 2], good + b"\x00", *changed]


_FLOOD_HZ = 1000.0


def flood(endpoints: Sequence[str], keys: Keys, seconds: float) -> int:
    """Send bad messages on every key in turn, from a separate session; returns how many."""
    with open_reader_session(endpoints) as session:
        time.sleep(0.5)  # until the links are there
        stream = _stream(keys)
        start, sent = time.monotonic(), 0
        while (passed := time.monotonic() - start) < seconds:
            while sent < passed * _FLOOD_HZ:
                key, payload, attachment = next(stream)
                session.put(
                    key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.DROP
                )
                sent += 1
            time.sleep(0.001)
        time.sleep(0.2)
        return sent


def _stream(keys: Keys) -> Iterator[tuple[str, bytes, bytes | None]]:
    """(key, payload, attachment), without end; every 500th is followed by one that is too large for any
    key."""
    kinds: dict[str, Message] = {type(m).__name__: m for m in messages()}
    small = {
        keys.request: "PerceptionRequest",
        keys.estimates: "Estimates",
        keys.correction: "CorrectionMessage",
        keys.pose("tea_box", 0): "PoseMessage",
        keys.objects: "ObjectsMessage",
        keys.health("tracker"): "HealthMessage",
        keys.truth: "TruthMessage",
    }
    pixels = {
        keys.frame: "FrameHeader",
        keys.look: "Look",
        keys.detections: "Detections",
        keys.masks: "Masks",
    }
    _, payload = pack(images())
    out: list[tuple[str, bytes, bytes | None]] = []
    for key, kind in small.items():
        out += [(key, data, None) for data in bad_bytes(encode(kinds[kind]))]
    for key, kind in pixels.items():
        good = encode(kinds[kind])
        out += [(key, payload, data) for data in bad_bytes(good)]
        # A good header with no pixels or too few, and pixels without a header.
        out += [(key, b"", good), (key, payload[:-1], good), (key, payload, None)]
    for number, item in enumerate(cycle(out)):
        yield item
        if number % 500 == 0:
            yield (keys.correction, bytes(_OVER_EVERY_CAP), None)
