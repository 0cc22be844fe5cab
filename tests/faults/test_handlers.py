"""Any message under any key, in any order: a worker's step takes it, or counts and drops it."""

from __future__ import annotations

import io
import os
import random
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
import zenoh

from huepose.estimation import Estimator
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.view_detector import ViewDetector
from huepose.reinit import ReinitConfig, ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.support.errors import InputError
from huepose.tracking import Tracker
from huepose_protos.examples import messages
from huepose_protos.keys import Keys
from huepose_protos.messages import FrameHeader, ObjectEntry
from huepose_services.boxes import SearchedBoxes
from huepose_services.camera.publish import packed
from huepose_services.chaos.intruder import bad_bytes
from huepose_services.detector import DetectorWork
from huepose_services.estimator import EstimatorWork
from huepose_services.following import Follower
from huepose_services.models import outline
from huepose_services.reinit import ReinitWork
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.health import Health
from huepose_services.runtime.inbox import Inbox
from huepose_services.runtime.log import Log
from huepose_services.segmenter import SegmenterWork
from huepose_services.steering import ObjectList
from huepose_services.tracker import TrackerWork

SECONDS = float(os.environ.get("HUEPOSE_FUZZ_S", "2"))
SEED = int(os.environ.get("HUEPOSE_FUZZ_SEED", "0"))
CONFIG = Config()
KEYS: Keys = CONFIG.keys
KINDS = {type(m).__name__: m for m in messages()}
SMALL = {
    KEYS.request: "PerceptionRequest",
    KEYS.estimates: "Estimates",
    KEYS.correction: "CorrectionMessage",
    KEYS.pose("006_mustard_bottle", 3): "PoseMessage",
    KEYS.objects: "ObjectsMessage",
    KEYS.truth: "TruthMessage",
}
PIXELS = {KEYS.frame: "FrameHeader", KEYS.look: "Look", KEYS.detections: "Detections", KEYS.masks: "Masks"}
NUMBERS = (0, 1, -1, 2, 7, 0.5, -1e-12, 1e-3, 1e9, 1e300, 2**31, 2**62, 2**63 - 1)


class _Session:
    """A session without other sessions."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: SimpleNamespace(
            matching_status=SimpleNamespace(matching=False),
            put=lambda *_, **__: None,
            undeclare=lambda: None,
            declare_subscriber=lambda *_, **__: None,
        )


class _Inbox(Inbox):
    """An inbox that a test fills, by key."""

    def __init__(self, session: zenoh.Session) -> None:
        super().__init__(session)
        self.places: dict[Any, str] = {}
        self._key = ""

    def ring(self, key: str, *arguments: Any, **named: Any) -> Any:
        self._key = key
        return super().ring(key, *arguments, **named)

    def queue(self, key: str, *arguments: Any, **named: Any) -> Any:
        self._key = key
        return super().queue(key, *arguments, **named)

    def liveliness(self, key: str) -> Any:
        self._key = key
        return super().liveliness(key)

    def _start(self, subscriber: Any, place: Any) -> None:
        self.places[place] = self._key

    def hand(self, key: str, payload: bytes, header: bytes | None) -> None:
        data = SimpleNamespace(to_bytes=lambda: payload, as_shm=lambda: None)
        above = None if header is None else SimpleNamespace(to_bytes=lambda: header)
        for place, mine in self.places.items():
            if zenoh.KeyExpr(mine).intersects(zenoh.KeyExpr(key)):
                place._put(cast(zenoh.Sample, SimpleNamespace(key_expr=key, payload=data, attachment=above)))


def _bus(worker: str) -> tuple[Bus, _Inbox]:
    session = cast(zenoh.Session, _Session())
    bus = Bus(session, KEYS, worker, Log(worker, io.StringIO()), Health(worker))
    bus.inbox = _Inbox(session)
    return bus, bus.inbox


def _work(worker: str, bus: Bus, model: Any) -> Any:
    models, outlines = {model.name: model}, {model.name: outline(model)}

    def load(name: str) -> Any:
        raise InputError("reference model", found=name, expected=model.name)

    follower: Follower[Any] = Follower(bus, load, models)
    if worker == "tracker":
        return TrackerWork(bus, Tracker(models), follower, CONFIG)
    if worker == "estimator":
        return EstimatorWork(bus, Estimator(models), follower)
    if worker == "segmenter":
        return SegmenterWork(bus, DepthSegmenter(), outlines, follower)
    if worker == "detector":
        return DetectorWork(bus, SearchedBoxes(outlines, ViewDetector(models)), follower)
    entry = ObjectEntry(object=model.name, max_instances=2, searching=2)

    def slot(name: str, count: int) -> ObjectSlot:
        return ObjectSlot.of(model, count)

    loop = ReinitLoop(ReinitConfig(), [slot(model.name, 2)])
    return ReinitWork(bus, loop, ObjectList([entry], slot))


def _corrupted(rng: random.Random, tree: Any) -> Any:
    """The tree with one value replaced, and perhaps with list elements dropped or doubled."""
    if isinstance(tree, dict) and tree:
        key = rng.choice(list(tree))
        return {**tree, key: _corrupted(rng, tree[key])}
    if isinstance(tree, list) and tree:
        k = rng.randrange(len(tree))
        more = [_corrupted(rng, tree[k])] * rng.choice((1, 1, 1, 0, 2))
        return [*tree[:k], *more, *tree[k + 1 :]]
    return (
        rng.choice((None, *NUMBERS, -rng.choice(NUMBERS), rng.random()))
        if not isinstance(tree, str)
        else tree
    )


def _now(tree: Any, frame: FrameHeader) -> Any:
    """The tree with the time and camera epoch of this frame; a frame header in it becomes this frame's."""
    if isinstance(tree, dict):
        if "buffers" in tree:
            return msgspec.to_builtins(frame)
        fresh = {"publish_ns": now_ns(), "capture_ns": frame.capture_ns, "camera_epoch": frame.camera_epoch}
        return {k: fresh.get(k, _now(v, frame)) for k, v in tree.items()}
    return [_now(one, frame) for one in tree] if isinstance(tree, list) else tree


@pytest.mark.parametrize("worker", ["tracker", "reinit", "detector", "segmenter", "estimator"])
def test_no_message_breaks_a_workers_step(worker, tea_box, box_frame):
    rng = random.Random(SEED)
    bus, inbox = _bus(worker)
    work = _work(worker, bus, replace(tea_box, name="006_mustard_bottle"))
    picture = packed(box_frame, 1e-4)
    taken, until = 0, time.process_time() + SECONDS
    while taken < 100 or time.process_time() < until:
        frame = msgspec.structs.replace(
            KINDS["FrameHeader"],
            publish_ns=now_ns(),
            capture_ns=now_ns(),
            frame_id=taken,
            intrinsics=picture.intrinsics,
            buffers=picture.buffers,
        )
        key, kind = rng.choice([*SMALL.items(), *PIXELS.items()])
        tree = _now(msgspec.to_builtins(KINDS[kind], builtin_types=(bytes,)), frame)
        good = msgspec.msgpack.encode(tree)
        data = rng.choice((good, rng.choice(bad_bytes(good)), msgspec.msgpack.encode(_corrupted(rng, tree))))
        payload = rng.choice((picture.payload, picture.payload, picture.payload[:-1], b""))
        inbox.hand(key, *((data, None) if key in SMALL else (payload, data)))
        work.step()
        taken += 1
    assert bus.health.errors > 0, "none of it was refused"
    assert bus.health.counters.keys() - {"wire_errors"}, "none of it was taken"
