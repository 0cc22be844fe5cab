"""Publishes the frames of a live camera as soon as they come, with timestamps of this machine's clock.

Each image is published once; if several wait, only the newest. While none comes, health has the state
`waiting` and the reason: what was expected, what was found, what to do. Health also shows faults of the
images that come. A new camera epoch begins when the camera is opened, when its intrinsics change, and when
its timestamps go back, so that no track of old images is applied to new ones. A source that is played once
is opened when the other workers are there; its end ends the pipeline.
"""

from __future__ import annotations

import secrets

from huepose.geometry import Camera, RgbdFrame
from huepose.support.errors import InputError
from huepose_services.camera.audience import WAIT_TO_PLAY_ONCE_NS, Audience
from huepose_services.camera.condition import STOPPED, Condition
from huepose_services.camera.device_clock import DeviceClock
from huepose_services.camera.live import LiveSource
from huepose_services.camera.publish import FramePublisher, packed
from huepose_services.camera.reader import PATIENCE_PICTURES, Reader, Taken
from huepose_services.convert import LARGEST_STEP
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.one_camera import SHORTEST_NS
from huepose_services.runtime.pulse import notify
from huepose_services.runtime.work import Work

_LONGEST_STEP_S = 0.05
_SAY_AGAIN_NS = 30 * SECOND
_SILENT_S = 1.0
"""After this time, and at least the time of PATIENCE_PICTURES images, it is reported that none comes."""
_BACK_NS = SHORTEST_NS
"""A timestamp that is older than the newest one by more than this begins a new epoch. For a smaller step
back, readers ignore frames until the timestamps have caught up, which takes no longer than their change to
a new epoch."""
_NOTHING_IS_SEEN = ("depth", "dark", "grey")
"""The complaints about images in which no object can be found."""
# A thread that hangs in the SDK cannot be ended: only a new process can open the camera again.
_GIVE_UP_AFTER_S = 30.0


class LiveIngest(Work):
    """Waits for an image only a short time in each step, so that the worker's loop goes on."""

    ready = False
    """Whether there was a good image."""

    def __init__(self, bus: Bus, config: Config, source: LiveSource) -> None:
        self._bus, self._config = bus, config
        self._publisher = FramePublisher(bus, config)
        self._audience = Audience(bus, config) if config.camera.once else None
        settings = config.camera
        self._reader = Reader(source, float(settings.rate))
        self._made_ns, self._ended_ns = now_ns(), 0
        self._name = source.name
        self._clock = DeviceClock()
        self._condition = Condition(
            float(settings.rate), LARGEST_STEP * settings.depth_scale_m, settings.check
        )
        self._complaints: dict[str, str] = {}
        self._opening = -1
        self._camera: Camera | None = None
        self._epoch, self._frame_id, self._newest_ns = 0, 0, 0
        self._reported: str | None = None
        self._none_comes = False
        self._say_ns = 0
        bus.health.state = "waiting"
        # A source that is played once waits for the other workers, so they must not wait for it.
        self.ready = config.camera.once

    def due_ns(self) -> int | None:
        """Now, since the step itself waits for an image; soon, if the camera is not opened yet."""
        return now_ns() + (0 if self._reader.started else int(_LONGEST_STEP_S * SECOND))

    def step(self) -> None:
        """Publish the newest image, or report what is wrong. Raises SystemExit if the SDK hangs."""
        if self._audience is not None and not self._reader.started:
            if self._audience.may_begin(now_ns() - self._made_ns > WAIT_TO_PLAY_ONCE_NS):
                self._reader.start()
            return
        over = self._reader.over
        taken = self._reader.take(_LONGEST_STEP_S)
        if self._audience is not None and over and taken is None:
            self._end(self._audience)
            return
        counters = self._bus.health.counters
        counters["frames_skipped"], counters["frames_repeated"] = self._reader.skipped, self._reader.repeated
        if taken is not None:
            self._take(taken)
        trouble = self._reader.trouble
        silence = None if trouble else self._silence()
        news = self._complain(trouble is None)
        self._bus.health.picture = self._nothing_is_seen(trouble, silence)
        missing = trouble or silence
        self._bus.health.warn_while("silence", missing)
        if trouble != self._reported:
            self._reported, self._say_ns = trouble, 0
            notify(f"STATUS={trouble or 'ready'}")  # for `systemctl status`
        good = self._frame_id and "apart" not in self._complaints and missing is None
        self._bus.health.state = "ready" if good else "waiting"
        self._say_at_once(news, missing is not None)
        if trouble is None:
            return
        if now_ns() >= self._say_ns:
            self._say_ns = now_ns() + _SAY_AGAIN_NS
            self._bus.log.seldom(trouble, trouble)
        if self._reader.stuck_s() > _GIVE_UP_AFTER_S:
            text = f"{self._name} has not answered for {_GIVE_UP_AFTER_S:.0f} s: a new process opens it again"
            raise SystemExit(text)

    def close(self) -> None:
        """Close the camera."""
        self._reader.close()

    def _end(self, audience: Audience) -> None:
        """Stay until the last frame was read, because the pool of frames ends with this process."""
        now = now_ns()
        self._ended_ns = self._ended_ns or now
        if audience.is_done(self._epoch, self._bus.health.frame_id or 0, now - self._ended_ns):
            self._bus.log.say(f"{self._name} has ended after {self._reader.pictures} images")
            self.finished = True
            if (trouble := self._reader.trouble) is not None:
                self._bus.health.failed(trouble)
                self.fault = InputError(
                    self._config.camera.path,
                    found=trouble.removeprefix(f"{self._name}: ").rstrip("."),
                    expected="images to the end: with camera.once it is not begun again",
                )

    def _silence(self) -> str | None:
        """The report that no image has come for a while, before the cause is known; None if images come."""
        silent_s, usual_s = self._reader.silent_s(), 1.0 / float(self._config.camera.rate)
        if silent_s is None or silent_s < max(_SILENT_S, PATIENCE_PICTURES * usual_s):
            return None
        return f"{self._name}: no image for {silent_s:.0f} s"

    def _say_at_once(self, news: bool, none_comes: bool) -> None:
        """Publish health at once if complaints changed, or images stopped or came again."""
        if news or none_comes != self._none_comes:
            self._none_comes = none_comes
            self._bus.say_health()

    def _take(self, taken: Taken) -> None:
        """Examine an image, and publish it if colour and depth are of the same time."""
        if taken.opening != self._opening:
            self._begin_opening(taken.opening)
        if self._condition.look(taken.shot, now_ns(), taken.device_clock_is_host):
            self._publish(taken)
        else:
            self._bus.health.count("images_apart")

    def _complain(self, open_: bool) -> bool:
        """Warn of faults of the images that come. Returns whether the faults have changed."""
        health, now = self._bus.health, now_ns()
        if not open_:
            self._condition.reopened()
        elif self._frame_id:
            self._condition.count(self._reader.pictures, now)
        complaints = self._lasting(now)
        for kind in {*complaints, *self._complaints}:
            health.warn_while(kind, complaints.get(kind))
        new = complaints.keys() - self._complaints.keys()
        over = self._complaints.keys() - complaints.keys()
        self._complaints = complaints
        for kind in sorted(new):
            self._bus.log.seldom(f"pictures: {kind}", complaints[kind])
        return bool(new or over)

    def _nothing_is_seen(self, trouble: str | None, silence: str | None) -> str:
        """Why no object can be found; empty if nothing prevents it. trouble: why no image comes; silence:
        the report that none comes, if the reason is not known."""
        if none_comes := trouble or silence or self._complaints.get("apart"):
            silent_s = self._reader.silent_s() if trouble else None
            head = "comes" if silent_s is None else f"has come for {silent_s:.0f} s"
            return f"No image {head}, and perception waits for the next. {none_comes}"
        return _nothing_is_seen(self._complaints)

    def _lasting(self, now: int) -> dict[str, str]:
        """The faults of the images that last now, as sentences by kind."""
        return {kind: f"{self._name}: {text}" for kind, text in self._condition.complaints(now).items()}

    def _publish(self, taken: Taken) -> None:
        shot, capture_ns = taken.shot, self._captured_ns(taken)
        back_ns = self._newest_ns - capture_ns
        if back_ns > _BACK_NS:
            self._condition.went_back(back_ns, now_ns())
        if shot.camera != self._camera or back_ns > _BACK_NS:
            self._begin_epoch(shot.camera)
        self._newest_ns = max(self._newest_ns, capture_ns)
        frame = RgbdFrame(shot.color, shot.depth, shot.camera, T_parent_cam=shot.T_parent_cam)
        settings = self._config.camera
        truths = shot.truths if settings.truth else None
        packed_frame = packed(frame, settings.depth_scale_m, truths, self._name, shot.number)
        wrong = self._lasting(now_ns())
        self._publisher.publish(
            packed_frame,
            self._epoch,
            self._frame_id,
            capture_ns,
            faults=(_nothing_is_seen(wrong), wrong.get(STOPPED, "")),
        )
        self._frame_id += 1
        self.ready = True

    def _captured_ns(self, taken: Taken) -> int:
        """The capture time of an image, CLOCK_MONOTONIC; not after its arrival."""
        shot = taken.shot
        if taken.device_clock_is_host:
            return min(shot.device_ns, shot.arrived_ns)
        capture_ns = self._clock.capture_ns(shot.device_ns, shot.arrived_ns)
        self._bus.health.counters["clock_restarts"] = self._clock.restarts
        return capture_ns

    def _begin_opening(self, opening: int) -> None:
        """The first image of a new opening: forget what was known of the last one."""
        self._opening, self._camera, self._newest_ns = opening, None, 0
        self._clock = DeviceClock()
        self._condition.reopened()

    def _begin_epoch(self, camera: Camera) -> None:
        """Begin a camera epoch. The log has the intrinsics of each opening; a later change is a
        complaint."""
        if self._camera is None:
            self._bus.log.say(
                f"{self._name}: {camera.width} x {camera.height}, fx {camera.fx:.1f} fy {camera.fy:.1f}"
            )
        self._camera = camera
        self._epoch, self._frame_id, self._newest_ns = secrets.randbits(62), 0, 0


def _nothing_is_seen(complaints: dict[str, str]) -> str:
    return next((complaints[kind] for kind in _NOTHING_IS_SEEN if kind in complaints), "")
