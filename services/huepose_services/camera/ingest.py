"""Publishes the frames of a source when they are due, and their ground truth if `camera.truth` is set.

Deadlines are absolute: a late frame does not delay the ones after it. A timestamp is the time at which the
frame was due, so the intervals between timestamps are exactly the source's. A delay of more than a tenth of
a second moves the schedule, so that no burst is published.

Playing starts when the other workers are there, or after a while without them. A recording that is played
once shows its first frame until every object has been acquired in it, for `first_frame_s` at most, and ends
when its last frame has been read. A later image that cannot be read is left out; if no image of a whole
pass can be read, the worker ends with that error.
"""

from __future__ import annotations

import secrets
from collections import deque
from contextlib import suppress
from dataclasses import dataclass

from huepose.datasets.types import Scene
from huepose.support.errors import InputError
from huepose_services.camera.audience import WAIT_TO_PLAY_ONCE_NS, Audience
from huepose_services.camera.live_ingest import LiveIngest
from huepose_services.camera.publish import FramePublisher, Packed, packed
from huepose_services.camera.sources import open_source
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import LIVE_SOURCES, CameraConfig
from huepose_services.runtime.work import Work

_BEHIND_NS = SECOND // 10
_WAIT_TO_LOOP_NS = 20 * SECOND
_SHOW_AGAIN_NS = SECOND // 2
_LONGEST_GAP_NS = 10 * SECOND
_BUSY_WINDOW_NS, _BUSY_FROM = 60 * SECOND, 3
# The rendered scene ends where it began; a recording does not.
_RENDERED = (
    "a rendered scene, repeated every {:.0f} s: objects rotate fast, pass in front of each other and are "
    "occluded by a bar now and then, so it is normal that one is SUSPECT or LOST for a moment"
)
_AGAIN = (
    "the recording begins again, and objects jump to where they were in its first image: those that become "
    "LOST are searched for; with camera.once: true it would end here"
)


def make(bus: Bus, config: Config) -> Ingest | LiveIngest:
    """The camera worker's work."""
    kind = LiveIngest if config.camera.source in LIVE_SOURCES else Ingest
    return kind(bus, config, open_source(config))


@dataclass
class _Hold:
    """The first frame of a recording, published again and again until its objects are acquired."""

    since_ns: int
    capture_ns: int
    frame_id: int
    shown_ns: int


class Schedule:
    """When each frame of a source is due, pass after pass, as absolute times: nothing drifts.

    `index` counts frames since the start; the source's image_ids are those of one pass."""

    def __init__(self, source: Scene, camera: CameraConfig, start_ns: int) -> None:
        self._ids = source.image_ids
        self._id_step = max(self._ids) + 1
        self._once = camera.once
        self._start_ns = start_ns
        if camera.rate == "recorded":
            gaps = _gaps(source)
            known = sorted(gap for gap in gaps if gap)
            usual = known[len(known) // 2] if known else SECOND // 30
            self._offsets = [0]
            for gap in [*gaps, None]:
                self._offsets.append(self._offsets[-1] + (usual if gap is None else gap))
        else:
            period = SECOND / float(camera.rate)
            self._offsets = [round(i * period) for i in range(len(self._ids) + 1)]

    def begins_again(self, index: int) -> bool:
        """Whether a frame is the first one of a later pass."""
        return index > 0 and index % len(self._ids) == 0 and not self._once

    @property
    def length_s(self) -> float:
        """How long one pass takes."""
        return self._offsets[-1] / SECOND

    def image(self, index: int) -> int | None:
        """The image of a frame; None after the last one."""
        if self._once and index >= len(self._ids):
            return None
        return self._ids[index % len(self._ids)]

    def frame_id(self, index: int) -> int:
        """The image's number on the first pass; on later passes that plus a multiple of the pass length."""
        return self._ids[index % len(self._ids)] + index // len(self._ids) * self._id_step

    def due_ns(self, index: int) -> int:
        """The time at which a frame is due."""
        passes, place = divmod(index, len(self._ids))
        return self._start_ns + passes * self._offsets[-1] + self._offsets[place]

    def postpone(self, by_ns: int) -> None:
        """Move all frames that are still to come."""
        self._start_ns += by_ns


def _gaps(source: Scene) -> list[int | None]:
    """The times between the captures of images. None if a timestamp is not after the last one: two frames
    never have one time. 0 before an image without a timestamp, which is left out."""
    gaps: list[int | None] = []
    last: int | None = None
    for image in source.image_ids:
        stamp = None
        with suppress(InputError):
            stamp = source.stamp_ns(image)
        if stamp is None or last is None:
            gaps.append(0)
        else:
            gaps.append(min(stamp - last, _LONGEST_GAP_NS) if stamp > last else None)
        last = last if stamp is None else stamp
    return gaps[1:]


class Busy:
    """Counts how often the camera was late in the last minute, and warns from the third time on."""

    def __init__(self) -> None:
        self._late: deque[tuple[int, int]] = deque()

    def late(self, by_ns: int, now_ns: int) -> str:
        """Note that a frame was late; return the line for the log."""
        self._late.append((now_ns, by_ns))
        return f"frames come {by_ns * 1e-6:.0f} ms late: this computer is busy"

    def warning(self, now_ns: int) -> str | None:
        """The warning for health; None if the camera is on time."""
        while self._late and now_ns - self._late[0][0] > _BUSY_WINDOW_NS:
            self._late.popleft()
        if len(self._late) < _BUSY_FROM:
            return None
        worst_ms = max(by_ns for _, by_ns in self._late) * 1e-6
        return (
            f"this computer is busy: the camera was late {len(self._late)} times in the last minute, by up "
            f"to {worst_ms:.0f} ms; end other programs, or set camera.rate lower"
        )


class Ingest(Work):
    """Waits for the other workers, plays, and waits until the last frame was read."""

    def __init__(self, bus: Bus, config: Config, source: Scene) -> None:
        self._bus, self._camera, self._source = bus, config.camera, source
        self._epoch = secrets.randbits(62)
        self._audience = Audience(bus, config)
        self._publisher = FramePublisher(bus, config)
        self._made_ns = now_ns()
        self._index = 0
        self._image: Packed | None = self._prepare(source.image_ids[0])
        self._unread = self._unread_in_a_row = 0
        self._schedule: Schedule | None = None
        self._hold: _Hold | None = None
        self._busy = Busy()
        self._ended_ns: int | None = None
        bus.health.camera_epoch = self._epoch
        bus.health.state = "waiting"

    def due_ns(self) -> int | None:
        """When the next frame is due."""
        if self._schedule is None or self._hold is not None or self._ended_ns is not None:
            return None
        return self._schedule.due_ns(self._index)

    def step(self) -> None:
        """Publish the frame that is due."""
        now = now_ns()
        if self._schedule is None:
            patience_ns = WAIT_TO_PLAY_ONCE_NS if self._camera.once else _WAIT_TO_LOOP_NS
            if self._audience.may_begin(now - self._made_ns > patience_ns):
                self._begin(now)
        elif self._ended_ns is not None:
            self._wait_for_readers(self._ended_ns, now)
        elif self._hold is not None:
            self._hold_first_frame(self._hold, self._schedule, now)
        else:
            self._play(self._schedule, now)

    def _begin(self, now: int) -> None:
        """Publish the first frame, which takes long because zenoh makes the pool of shared memory for
        it."""
        self._schedule = Schedule(self._source, self._camera, now)
        self._bus.health.state = "ready"
        if self._camera.source == "synthetic":
            self._bus.log.say(_RENDERED.format(self._schedule.length_s))
        self._publish(self._schedule.frame_id(0), now)
        self._schedule.postpone(now_ns() - now)
        if self._camera.once:
            self._hold = _Hold(now_ns(), now, self._schedule.frame_id(0), now_ns())
        else:
            self._prepare_next(self._schedule)

    def _hold_first_frame(self, hold: _Hold, schedule: Schedule, now: int) -> None:
        until_ns = hold.since_ns + int(self._camera.first_frame_s * SECOND)
        if now < until_ns and not self._audience.has_acquired_all():
            if now - hold.shown_ns > _SHOW_AGAIN_NS:
                hold.shown_ns = now
                self._publish(hold.frame_id, hold.capture_ns, "frames_repeated")
            return
        self._audience.ignore_poses()
        schedule.postpone(now - hold.since_ns)
        self._hold = None
        self._prepare_next(schedule)

    def _play(self, schedule: Schedule, now: int) -> None:
        due = schedule.due_ns(self._index)
        if now < due:
            return
        if self._image is None:
            self._prepare_next(schedule)
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
            return
        if schedule.begins_again(self._index) and self._camera.source != "synthetic":
            self._bus.log.seldom("again", _AGAIN, level="info")
        self._image = None  # if this image cannot be read, the one before is not published again
        try:
            self._image = self._prepare(image)
        except InputError as error:
            self._leave_out(error)
        else:
            self._unread_in_a_row = 0

    def _leave_out(self, error: InputError) -> None:
        self._unread += 1
        self._unread_in_a_row += 1
        self._bus.health.count("frames_unread")
        self._bus.log.seldom("unread", f"an image is left out: {error}")
        if self._unread_in_a_row == len(self._source.image_ids):
            self.fault, self.finished = error, True

    def _prepare(self, image: int) -> Packed:
        frame, source = self._source.frame(image), self._source
        truths = source.truths(image) if self._camera.truth else None
        return packed(frame, self._camera.depth_scale_m, truths, source.name, image)

    def _publish(self, frame_id: int, capture_ns: int, counted_as: str = "frames") -> None:
        if self._image is not None:
            self._publisher.publish(self._image, self._epoch, frame_id, capture_ns, counted_as)

    def _wait_for_readers(self, ended_ns: int, now: int) -> None:
        """Stay until the last frame was read, because the pool of frames ends with this process."""
        if self._audience.is_done(self._epoch, self._bus.health.frame_id or 0, now - ended_ns):
            self._bus.log.say(f"the recording has ended after {self._played()}")
            self._bus.health.state = "ended"
            self.finished = True

    def _played(self) -> str:
        if not self._unread:
            return f"{self._index} frames"
        return f"{self._index - self._unread} of {self._index} frames: {self._unread} could not be read"
