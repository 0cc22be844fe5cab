"""Publishes the frames of a source when they are due, and the truth about them when told to.

Deadlines are absolute: a late frame does not move the ones after it. A stamp is the time at which the frame
was due, so the intervals between stamps are exactly the source's. Falling behind by more than a tenth of a
second moves the schedule instead of publishing a burst.

It starts when the other workers are there, or after a while without them. A recording that is played once
stands on its first frame until every object has been acquired in it, for `first_frame_s` at most, and ends
when its last frame has been read.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from huepose.datasets.types import GroundTruth, Scene
from huepose_services.camera.audience import Audience
from huepose_services.camera.live_ingest import LiveIngest
from huepose_services.camera.publish import FramePublisher, Packed, packed
from huepose_services.camera.schedule import Busy, Schedule
from huepose_services.camera.sources import open_source
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import LIVE_SOURCES
from huepose_services.runtime.work import Work

_BEHIND_NS = SECOND // 10
_WAIT_TO_PLAY_ONCE_NS, _WAIT_TO_LOOP_NS = 120 * SECOND, 20 * SECOND
_SHOW_AGAIN_NS = SECOND // 2
_GRACE_NS, _WAIT_FOR_READERS_NS = SECOND // 2, int(2.5 * SECOND)


def make(bus: Bus, config: Config) -> Ingest | LiveIngest:
    """The camera worker's work."""
    kind = LiveIngest if config.camera.source in LIVE_SOURCES else Ingest
    return kind(bus, config, open_source(config))


@dataclass(frozen=True)
class _Shot:
    """A frame that is ready to go."""

    image: int
    picture: Packed
    truths: tuple[GroundTruth, ...]


@dataclass
class _Stand:
    """The first frame of a recording, shown again now and then while it is looked at."""

    since_ns: int
    capture_ns: int
    frame_id: int
    shown_ns: int


class Ingest(Work):
    """Waits for the audience, plays, and waits until the last frame was read."""

    def __init__(self, bus: Bus, config: Config, source: Scene) -> None:
        self._bus, self._camera, self._source = bus, config.camera, source
        self._epoch = secrets.randbits(62)
        self._audience = Audience(bus, config)
        self._publisher = FramePublisher(bus, config)
        self._made_ns = now_ns()
        self._index = 0
        self._shot = self._prepare(source.image_ids[0])
        self._schedule: Schedule | None = None
        self._stand: _Stand | None = None
        self._busy = Busy()
        self._ended_ns: int | None = None
        bus.health.camera_epoch = self._epoch
        bus.health.state = "waiting"

    def due_ns(self) -> int | None:
        """When the next frame is due."""
        if self._schedule is None or self._stand is not None or self._ended_ns is not None:
            return None
        return self._schedule.due_ns(self._index)

    def step(self) -> None:
        """Publish what is due."""
        now = now_ns()
        if self._schedule is None:
            if self._may_begin(now):
                self._begin(now)
        elif self._ended_ns is not None:
            self._wait_for_readers(self._ended_ns, now)
        elif self._stand is not None:
            self._stand_on_first_frame(self._stand, self._schedule, now)
        else:
            self._play(self._schedule, now)

    def _may_begin(self, now: int) -> bool:
        patience_ns = _WAIT_TO_PLAY_ONCE_NS if self._camera.once else _WAIT_TO_LOOP_NS
        if not self._audience.complete() and now - self._made_ns > patience_ns:
            self._bus.log.say(f"playing without {', '.join(sorted(self._audience.missing))}")
            self._audience.begin_without()
        return self._audience.complete()

    def _begin(self, now: int) -> None:
        """The first frame, which takes long because zenoh makes the pool of shared memory for it."""
        self._schedule = Schedule(self._source, self._camera, now)
        self._bus.health.state = "ready"
        self._publish(self._schedule.frame_id(0), now)
        self._schedule.postpone(now_ns() - now)
        if self._camera.once:
            self._stand = _Stand(now_ns(), now, self._schedule.frame_id(0), now_ns())
        else:
            self._prepare_next(self._schedule)

    def _stand_on_first_frame(self, stand: _Stand, schedule: Schedule, now: int) -> None:
        until_ns = stand.since_ns + int(self._camera.first_frame_s * SECOND)
        if now < until_ns and not self._audience.has_acquired_all():
            if now - stand.shown_ns > _SHOW_AGAIN_NS:
                stand.shown_ns = now
                self._publish(stand.frame_id, stand.capture_ns, "frames_repeated")
            return
        self._audience.ignore_poses()
        schedule.postpone(now - stand.since_ns)
        self._stand = None
        self._prepare_next(schedule)

    def _play(self, schedule: Schedule, now: int) -> None:
        due = schedule.due_ns(self._index)
        if now < due:
            return
        self._bus.health.warn_while("busy", self._busy.warning(now))
        if now - due > _BEHIND_NS:
            self._bus.health.count("late")
            self._bus.log.seldom("late", self._busy.late(now - due, now))
            schedule.postpone(now - due)
            due = now
        self._publish(schedule.frame_id(self._index), due)
        self._prepare_next(schedule)

    def _prepare_next(self, schedule: Schedule) -> None:
        self._index += 1
        image = schedule.image(self._index)
        if image is None:
            self._ended_ns = now_ns()
        else:
            self._shot = self._prepare(image)

    def _prepare(self, image: int) -> _Shot:
        frame = self._source.frame(image)
        truths = self._source.truths(image) if self._camera.truth else ()
        return _Shot(image, packed(frame, self._camera.depth_scale_m), truths)

    def _publish(self, frame_id: int, capture_ns: int, counted_as: str = "frames") -> None:
        shot, publisher = self._shot, self._publisher
        if self._camera.truth:
            publisher.publish_truth(
                shot.truths, self._epoch, frame_id, capture_ns, self._source.name, shot.image
            )
        publisher.publish(shot.picture, self._epoch, frame_id, capture_ns, counted_as)

    def _wait_for_readers(self, ended_ns: int, now: int) -> None:
        """The pool of frames goes with this process: stay until the last frame was read."""
        if self._audience.reads:
            read = self._audience.has_read(self._epoch, self._bus.health.frame_id or 0)
        else:
            read = now - ended_ns > _GRACE_NS
        if read or now - ended_ns > _WAIT_FOR_READERS_NS:
            self._bus.log.say(f"the recording has ended after {self._index} frames")
            self._bus.health.state = "ended"
            self.finished = True
