"""The viewer worker: newest frames and all poses in, a page for browsers out.

It holds a ring of one for frames and takes as many a second as it is told to; nothing waits for it. Poses are
shown on the frame that they are of: a frame waits for its poses for a moment.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import zenoh

from huepose.geometry import RgbdFrame
from huepose.judge.pairs_seen import pairs_seen
from huepose_protos import WireError
from huepose_protos.buffers import frame_images
from huepose_protos.fields import StateName
from huepose_protos.keys import last
from huepose_protos.messages import FrameHeader, HypothesesMessage, PoseMessage
from huepose_services import models
from huepose_services.convert import frame_from_wire, pose_of
from huepose_services.following import Follower
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.work import Work
from huepose_services.viewer.shapes import Body, warm_up

if TYPE_CHECKING:
    from huepose_services.viewer.show import Show

# So long a frame waits for the poses that are of it.
_PATIENCE_NS = SECOND // 8
_KEPT_NS = _SILENT_NS = SECOND
_CLOUD_EVERY = 2


def make(bus: Bus, config: Config) -> ViewerWork:
    """The viewer's work, its page being served."""
    from huepose_services.viewer.show import Show
    from huepose_services.viewer.sinks import served

    bodies = {name: Body.of(model) for name, model in models.load(config).items()}
    follower = Follower(bus, lambda name: Body.of(models.load_one(config, name)), bodies)
    warm_up()
    recording, address = served(config.viewer)
    bus.log.say(f"the page is {address}")
    return ViewerWork(bus, Show(recording, bodies), bodies, follower, config.viewer.image_rate_hz)


class ViewerWork(Work):
    """Pairs frames with their poses and shows both; tells what changes. bodies: what `show` draws of each
    object. hypotheses: shows all that the tracker holds possible; it says so only while somebody listens.
    pairs: shows the colour pairs of whole models. begins_with_picture: shows nothing before the first
    picture, as a file must, whose beginning is looked at."""

    def __init__(
        self,
        bus: Bus,
        show: Show,
        bodies: dict[str, Body],
        objects: Follower[Body],
        image_rate_hz: float,
        hypotheses: bool = False,
        pairs: bool = False,
        begins_with_picture: bool = False,
    ) -> None:
        self._begun = not begins_with_picture
        self._bus, self._show, self._bodies, self._objects = bus, show, bodies, objects
        self._period_ns = int(SECOND / image_rate_hz)
        keys, inbox = bus.keys, bus.inbox
        # Frames wake nobody: they are looked at when the next picture is due.
        self._frames = bus.frames(wakes=False)
        self._poses = inbox.queue(keys.poses)
        self._live = inbox.liveliness(keys.live())
        self._hypotheses = inbox.queue(keys.hypotheses) if hypotheses else None
        self._held: dict[int, HypothesesMessage] = {}
        self._pairs = pairs
        self._next_picture_ns = now_ns()
        self._waiting: tuple[FrameHeader, bytes] | None = None
        self._waiting_until_ns = 0
        self._recent: dict[tuple[str, int], dict[int, PoseMessage]] = {}
        # The stamp of the newest picture when an instance was last heard of, or of that pose, if it is newer.
        self._heard_ns: dict[tuple[str, int], int] = {}
        self._pictured_ns = 0
        self._states: dict[tuple[str, int], str] = {}
        self._pictures = 0
        self._frame_id = -1

    def due_ns(self) -> int | None:
        """When the next picture is due, or the waiting one has waited long enough."""
        return self._next_picture_ns if self._waiting is None else self._waiting_until_ns

    def step(self) -> None:
        """Take poses and a frame; show what is complete."""
        self._objects.keep_up(self._bodies)
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            self._take(pose)
        if self._hypotheses is not None:
            while (held := self._bus.take(self._hypotheses, HypothesesMessage)) is not None:
                self._held[held.capture_ns] = held
        now = now_ns()
        if self._waiting is None and now >= self._next_picture_ns:
            # Absolute deadlines; after a stop no burst.
            self._next_picture_ns = max(self._next_picture_ns + self._period_ns, now)
            self._waiting = self._bus.take_with_payload(self._frames, FrameHeader)
            self._waiting_until_ns = now + _PATIENCE_NS
        if self._waiting is not None and (self._has_poses(self._waiting[0]) or now >= self._waiting_until_ns):
            self._picture(*self._waiting)
            self._waiting = None
        while self._begun and (sample := self._live.take()) is not None:
            self._worker(last(str(sample.key_expr)), sample.kind == zenoh.SampleKind.PUT)

    def _take(self, pose: PoseMessage) -> None:
        started = now_ns()
        instance = (pose.object, pose.instance)
        kept = self._recent.setdefault(instance, {})
        kept[pose.capture_ns] = pose
        for old in [t for t in kept if pose.capture_ns - t > _KEPT_NS]:
            del kept[old]
        self._heard_ns[instance] = max(pose.capture_ns, self._pictured_ns)
        if self._begun:
            self._show_pose(pose)
        self._bus.health.worked_on(started, pose)

    def _show_pose(self, pose: PoseMessage) -> None:
        instance = (pose.object, pose.instance)
        self._show.at(pose.capture_ns + pose.realtime_offset_ns, pose.frame_id)
        before = self._states.get(instance)
        if before != pose.state:
            self._states[instance] = pose.state
            came_from = "" if before is None else f"{before} > "
            self._tell(f"{pose.object}/{pose.instance}  {came_from}{pose.state}", pose.state)
        self._show.pose(pose)
        if pose.frame_id != self._frame_id:
            # One point for each frame: its first pose.
            self._frame_id = pose.frame_id
            self._show.latency(pose.age_ms)

    def _worker(self, name: str, there: bool) -> None:
        """A worker has come or gone."""
        self._show.at(time.time_ns(), max(self._frame_id, 0))
        self._tell(f"worker {name} is {'there' if there else 'gone'}", "SEARCHING" if there else "LOST")

    def _tell(self, text: str, state: StateName) -> None:
        """A line in the page's log. The time is a label for people."""
        self._show.event(f"{time.strftime('%H:%M:%S')}  {text}", state)

    def _has_poses(self, header: FrameHeader) -> bool:
        """Whether every instance that is tracked has said something of this frame, or of a later one."""
        living = [kept for kept in self._recent.values() if _newest(kept) > header.capture_ns - SECOND]
        return bool(living) and all(_newest(kept) >= header.capture_ns for kept in living)

    def _picture(self, header: FrameHeader, payload: bytes) -> None:
        try:
            frame, (color, depth) = frame_from_wire(header, payload), frame_images(header, payload)
        except WireError as error:
            self._bus.refuse(self._bus.keys.frame, error)
            return
        self._show.at(header.capture_ns + header.clock.realtime_offset_ns, header.frame_id)
        self._show.frame(header, color, depth, with_cloud=self._pictures % _CLOUD_EVERY == 0)
        at_ns = header.capture_ns
        self._forget_silent(at_ns)
        poses = [kept[at_ns] for kept in self._recent.values() if at_ns in kept]
        self._show.beliefs(poses)
        if self._hypotheses is not None:
            self._show.hypotheses(self._held.get(at_ns))
            self._held = {t: held for t, held in self._held.items() if t > at_ns}
        self._begun = True
        if self._pairs:
            self._show_pairs(frame, poses)
        self._pictures += 1
        self._bus.health.count("pictures")

    def _forget_silent(self, at_ns: int) -> None:
        """Take away what nobody spoke of for a second of pictures: an object that is no longer looked for, an
        instance of a tracker that died."""
        self._pictured_ns = at_ns
        for instance in [one for one, heard_ns in self._heard_ns.items() if at_ns - heard_ns > _SILENT_NS]:
            del self._heard_ns[instance], self._recent[instance]
            if self._states.pop(instance, None) is not None:
                self._show.gone(instance)
                self._tell(f"{instance[0]}/{instance[1]}  is no longer looked for or followed", "SEARCHING")

    def _show_pairs(self, frame: RgbdFrame, poses: Sequence[PoseMessage]) -> None:
        """The colour pairs of all poses of a frame."""
        seen = [
            pairs_seen(frame, body.whole, T_cam_obj)
            for pose in poses
            if (T_cam_obj := pose_of(pose)) is not None
            and (body := self._bodies.get(pose.object)) is not None
            and body.whole is not None
        ]
        pixels = np.concatenate([np.zeros((0, 2)), *(pixels for pixels, _ in seen)])
        self._show.pairs(pixels, np.concatenate([np.zeros(0, bool), *(other for _, other in seen)]))


def _newest(kept: dict[int, PoseMessage]) -> int:
    return max(kept, default=-1)
