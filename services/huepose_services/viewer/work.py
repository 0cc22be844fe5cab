"""The viewer worker: shows the newest frames and all poses on a page for browsers.

It has a ring of one frame and takes frames at a configured rate; nothing waits for it. Poses are shown on
the frame that they belong to: a frame waits a moment for its poses.
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

# The longest time that a frame waits for its poses.
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
    """Pairs frames with their poses, shows both, and logs changes of state. bodies: what `show` draws of
    each object; hypotheses: show all hypotheses of the tracker, which it publishes only while somebody
    listens; pairs: show the colour pairs of whole models; begins_with_picture: show nothing before the
    first image, needed for a file, which is viewed from its beginning."""

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
        # Frames do not wake the worker: it takes one when the next image is due.
        self._frames = bus.frames(wakes=False)
        self._poses = inbox.queue(keys.poses)
        self._live = inbox.liveliness(keys.live())
        self._hypotheses = inbox.queue(keys.hypotheses) if hypotheses else None
        self._held: dict[int, HypothesesMessage] = {}
        self._pairs = pairs
        self._next_image_ns = now_ns()
        self._waiting: tuple[FrameHeader, bytes] | None = None
        self._waiting_until_ns = 0
        self._recent: dict[tuple[str, int], dict[int, PoseMessage]] = {}
        # For each instance: the timestamp of its last pose, or of the newest image at that time if that is
        # later.
        self._heard_ns: dict[tuple[str, int], int] = {}
        self._shown_ns = 0
        self._states: dict[tuple[str, int], str] = {}
        self._images = 0
        self._frame_id = -1

    def due_ns(self) -> int | None:
        """When the next image is due, or the waiting one has waited long enough."""
        return self._next_image_ns if self._waiting is None else self._waiting_until_ns

    def step(self) -> None:
        """Take poses and a frame; show the frame when its poses are there."""
        self._objects.keep_up(self._bodies)
        while (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            self._take(pose)
        if self._hypotheses is not None:
            while (held := self._bus.take(self._hypotheses, HypothesesMessage)) is not None:
                self._held[held.capture_ns] = held
        now = now_ns()
        if self._waiting is None and now >= self._next_image_ns:
            # Absolute deadlines, but no burst after a stop.
            self._next_image_ns = max(self._next_image_ns + self._period_ns, now)
            self._waiting = self._bus.take_with_payload(self._frames, FrameHeader)
            self._waiting_until_ns = now + _PATIENCE_NS
        if self._waiting is not None and (self._has_poses(self._waiting[0]) or now >= self._waiting_until_ns):
            self._show_image(*self._waiting)
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
        self._heard_ns[instance] = max(pose.capture_ns, self._shown_ns)
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
            self._log(f"{pose.object}/{pose.instance}  {came_from}{pose.state}", pose.state)
        self._show.pose(pose)
        if pose.frame_id != self._frame_id:
            # One point for each frame: its first pose.
            self._frame_id = pose.frame_id
            self._show.latency(pose.age_ms)

    def _worker(self, name: str, there: bool) -> None:
        """Log that a worker has started or ended."""
        self._show.at(time.time_ns(), max(self._frame_id, 0))
        self._log(f"worker {name} is {'there' if there else 'gone'}", "SEARCHING" if there else "LOST")

    def _log(self, text: str, state: StateName) -> None:
        """Write a line to the page's log, with the time of day as text."""
        self._show.event(f"{time.strftime('%H:%M:%S')}  {text}", state)

    def _has_poses(self, header: FrameHeader) -> bool:
        """Whether every tracked instance has a pose of this frame, or of a later one."""
        living = [kept for kept in self._recent.values() if _newest(kept) > header.capture_ns - SECOND]
        return bool(living) and all(_newest(kept) >= header.capture_ns for kept in living)

    def _show_image(self, header: FrameHeader, payload: bytes) -> None:
        try:
            frame, (color, depth) = frame_from_wire(header, payload), frame_images(header, payload)
        except WireError as error:
            self._bus.refuse(self._bus.keys.frame, error)
            return
        self._show.at(header.capture_ns + header.clock.realtime_offset_ns, header.frame_id)
        self._show.frame(header, color, depth, with_cloud=self._images % _CLOUD_EVERY == 0)
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
        self._images += 1
        self._bus.health.count("images")

    def _forget_silent(self, at_ns: int) -> None:
        """Remove instances without a pose for a second of image time: of an object that is no longer
        searched for, or of a tracker that died."""
        self._shown_ns = at_ns
        for instance in [one for one, heard_ns in self._heard_ns.items() if at_ns - heard_ns > _SILENT_NS]:
            del self._heard_ns[instance], self._recent[instance]
            if self._states.pop(instance, None) is not None:
                self._show.gone(instance)
                self._log(f"{instance[0]}/{instance[1]}  is no longer searched for or tracked", "SEARCHING")

    def _show_pairs(self, frame: RgbdFrame, poses: Sequence[PoseMessage]) -> None:
        """Show the colour pairs of all poses of a frame."""
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
