"""Publishes the frames of a source when they are due, and the truth about them when told to.

Deadlines are absolute: a late frame does not move the ones after it. A stamp is the time at which the frame
was due, so the intervals between stamps are exactly the source's. Falling behind by more than a tenth of a
second moves the schedule instead of publishing a burst.

It starts when the other workers are there, or after a while without them. A recording that is played once
stands on its first frame for `first_frame_s`, so that objects can be acquired in it, and ends when its last
frame has been read.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import cast

from huepose.datasets.types import GroundTruth, Scene
from huepose_protos.buffers import pack
from huepose_protos.keys import last
from huepose_protos.messages import (
    BufferSpec,
    FrameHeader,
    HealthMessage,
    Intrinsics,
    TruthMessage,
    TruthObject,
)
from huepose_services.convert import (
    box_to_wire,
    depth_to_wire,
    intrinsics_to_wire,
    optional_pose_to_wire,
)
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config import CameraConfig, Config

_BEHIND_NS = SECOND // 10
_WAIT_TO_PLAY_ONCE_NS, _WAIT_TO_LOOP_NS = 120 * SECOND, 20 * SECOND
_WAIT_FOR_READERS_NS = int(2.5 * SECOND)
_LONGEST_GAP_NS = 10 * SECOND


def make(bus: Bus, config: Config) -> Ingest:
    """The camera worker's work."""
    module = import_module(f"huepose_services.camera.{config.camera.source}")
    return Ingest(bus, config, cast(Scene, module.open_source(config)))


class Schedule:
    """When each frame of a source is due, pass after pass.

    Frame `index` counts all frames since the start; image_ids are those of one pass."""

    def __init__(self, source: Scene, camera: CameraConfig, start_ns: int) -> None:
        self._ids = source.image_ids
        self._id_step = max(self._ids) + 1
        self._once = camera.once
        self._start_ns = start_ns
        if camera.rate == "recorded":
            stamps = [source.stamp_ns(i) for i in self._ids]
            gaps = [min(max(b - a, 0), _LONGEST_GAP_NS) for a, b in pairwise(stamps)]
            usual = sorted(gaps)[len(gaps) // 2] if gaps else SECOND // 30
            self._offsets = [0]
            for gap in [*gaps, usual]:
                self._offsets.append(self._offsets[-1] + gap)
        else:
            period = SECOND / float(camera.rate)
            self._offsets = [round(i * period) for i in range(len(self._ids) + 1)]

    def image(self, index: int) -> int | None:
        """The image of a frame; None after the last."""
        if self._once and index >= len(self._ids):
            return None
        return self._ids[index % len(self._ids)]

    def frame_id(self, index: int) -> int:
        """The image's number on the first pass; the same and a multiple of the length on later ones."""
        return self._ids[index % len(self._ids)] + index // len(self._ids) * self._id_step

    def due_ns(self, index: int) -> int:
        """The time at which a frame is due."""
        passes, place = divmod(index, len(self._ids))
        return self._start_ns + passes * self._offsets[-1] + self._offsets[place]

    def postpone(self, by_ns: int) -> None:
        """Move everything that is still to come."""
        self._start_ns += by_ns


@dataclass(frozen=True)
class _Shot:
    """A frame that is ready to go."""

    image: int
    intrinsics: Intrinsics
    buffers: list[BufferSpec]
    payload: bytes
    truths: tuple[GroundTruth, ...]


class Ingest:
    """Waits for the other workers, plays, and waits for the readers of the last frame."""

    def __init__(self, bus: Bus, config: Config, source: Scene) -> None:
        self._bus, self._config, self._source = bus, config, source
        self._camera = config.camera
        self.finished = False
        self._epoch = secrets.randbits(62)
        self._clock = this_clock()
        self._index = 0
        self._shot = self._prepare(source.image_ids[0])
        self._schedule: Schedule | None = None
        self._made_ns = now_ns()
        self._ended_ns: int | None = None
        others = {str(worker) for worker in config.workers if worker != "camera"}
        self._missing = others
        self._live = bus.inbox.liveliness(config.keys.live()) if self._missing else None
        reader = "tracker" if "tracker" in others else None
        self._reader = bus.inbox.queue(config.keys.health(reader)) if reader and self._camera.once else None
        bus.health.camera_epoch = self._epoch
        if self._missing:
            bus.health.state = "waiting"

    def due_ns(self) -> int | None:
        """When the next frame is due."""
        return None if self._schedule is None or self._ended_ns else self._schedule.due_ns(self._index)

    def step(self) -> None:
        """Publish what is due."""
        now = now_ns()
        if self._schedule is None:
            if not self._others_are_there(now):
                return
            self._schedule = Schedule(self._source, self._camera, now)
            self._bus.health.state = "ready"
        if self._ended_ns is not None:
            self._wait_for_readers(self._ended_ns, now)
            return
        due = self._schedule.due_ns(self._index)
        if now < due:
            return
        if now - due > _BEHIND_NS:
            self._bus.health.count("late")
            self._bus.log.seldom("late", f"behind by {(now - due) * 1e-6:.0f} ms: moving the schedule")
            self._schedule.postpone(now - due)
            due = now
        self._publish(self._schedule.frame_id(self._index), due)
        if self._index == 0:
            # The first frame takes long: zenoh makes the pool of shared memory for it.
            stand_ns = int(self._camera.first_frame_s * SECOND) if self._camera.once else 0
            self._schedule.postpone(now_ns() - due + stand_ns)
        self._index += 1
        image = self._schedule.image(self._index)
        if image is None:
            self._ended_ns = now_ns()
            return
        self._shot = self._prepare(image)

    def _prepare(self, image: int) -> _Shot:
        frame = self._source.frame(image)
        depth = depth_to_wire(frame.depth, self._camera.depth_scale_m)
        buffers, payload = pack({"color": frame.color, "depth": depth})
        intrinsics = intrinsics_to_wire(frame.camera, self._camera.depth_scale_m)
        truths = self._source.truths(image) if self._camera.truth else ()
        return _Shot(image, intrinsics, buffers, payload, truths)

    def _publish(self, frame_id: int, capture_ns: int) -> None:
        shot, bus, keys = self._shot, self._bus, self._config.keys
        started = now_ns()
        if self._camera.truth:
            bus.put(keys.truth, self._truth(shot, frame_id, capture_ns))
        header = FrameHeader(
            publish_ns=now_ns(),
            camera_epoch=self._epoch,
            frame_id=frame_id,
            capture_ns=capture_ns,
            clock=self._clock,
            frame=f"{self._camera.name}_color_optical",
            intrinsics=shot.intrinsics,
            buffers=shot.buffers,
        )
        bus.put_pixels(keys.frame, header, shot.payload)
        bus.health.frame_id = frame_id
        bus.health.count("frames")
        bus.health.worked(started, capture_ns)

    def _truth(self, shot: _Shot, frame_id: int, capture_ns: int) -> TruthMessage:
        objects = []
        for truth in shot.truths:
            translation, quaternion = optional_pose_to_wire(truth.T_cam_obj)
            objects.append(
                TruthObject(
                    object=truth.object,
                    object_id=truth.object_id,
                    instance=truth.instance,
                    translation=translation,
                    quaternion=quaternion,
                    visib_fract=truth.visib_fract,
                    box=None if truth.box_visib is None else box_to_wire(truth.box_visib),
                )
            )
        return TruthMessage(
            publish_ns=now_ns(),
            camera_epoch=self._epoch,
            frame_id=frame_id,
            capture_ns=capture_ns,
            scene=self._source.name,
            image=shot.image,
            objects=objects,
        )

    def _others_are_there(self, now: int) -> bool:
        while self._live is not None and (sample := self._live.take()) is not None:
            self._missing.discard(last(str(sample.key_expr)))
        patience_ns = _WAIT_TO_PLAY_ONCE_NS if self._camera.once else _WAIT_TO_LOOP_NS
        if self._missing and now - self._made_ns > patience_ns:
            self._bus.log.say(f"playing without {', '.join(sorted(self._missing))}")
            self._missing = set()
        return not self._missing

    def _wait_for_readers(self, ended_ns: int, now: int) -> None:
        """The pool of frames goes with this process: stay until the last frame was read."""
        last_id = self._bus.health.frame_id
        read = self._reader is None and now - ended_ns > SECOND // 2
        while self._reader is not None:
            message = self._bus.take(self._reader, HealthMessage)
            if message is None:
                break
            read = read or (message.camera_epoch == self._epoch and message.frame_id == last_id)
        if read or now - ended_ns > _WAIT_FOR_READERS_NS:
            self._bus.log.say(f"the recording has ended after {self._index} frames")
            self._bus.health.state = "ended"
            self.finished = True
