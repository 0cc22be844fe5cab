"""Bad messages for every key of a pipeline: what a broken or malicious sender could put on the bus."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import cycle

import msgspec
import zenoh

from huepose_protos import encode
from huepose_protos.buffers import pack
from huepose_protos.examples import images, messages
from huepose_protos.keys import Keys
from huepose_protos.messages import Message
from huepose_services.runtime.session import open_reader_session

_OVER_EVERY_CAP = 2 * 1024 * 1024


def bad_bytes(good: bytes) -> list[bytes]:
    """Ways in which the bytes of a message can be wrong: no message may be read from any."""
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
    spoilt = [msgspec.msgpack.encode(change) for change in changes]
    return [b"", b"\xc1", b"\xff" * 100, good[:-1], good[: len(good) // 2], good + b"\x00", *spoilt]


def flood(endpoints: Sequence[str], site: str, camera: str, *, seconds: float, rate_hz: float) -> int:
    """Send bad messages on every key in turn, from a session of its own; returns how many."""
    session = open_reader_session(endpoints)
    try:
        time.sleep(0.5)  # the links come up
        stream = _stream(Keys(site, camera))
        start, sent = time.monotonic(), 0
        while (passed := time.monotonic() - start) < seconds:
            while sent < passed * rate_hz:
                key, payload, attachment = next(stream)
                session.put(
                    key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.DROP
                )
                sent += 1
            time.sleep(0.001)
        return sent
    finally:
        time.sleep(0.2)
        session.close()


def _stream(keys: Keys) -> Iterator[tuple[str, bytes, bytes | None]]:
    """(key, payload, attachment) for ever; now and then one that is over every cap."""
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
        # A good header with pixels that are not there, too few, or without any header.
        out += [(key, b"", good), (key, payload[:-1], good), (key, payload, None)]
    for number, item in enumerate(cycle(out)):
        yield item
        if number % 500 == 0:
            yield (keys.correction, bytes(_OVER_EVERY_CAP), None)
