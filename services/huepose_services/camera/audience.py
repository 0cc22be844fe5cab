"""The workers that read a camera's frames: playback begins when they are there, and ends when they have
read the last frame."""

from __future__ import annotations

from huepose_protos.messages import HealthMessage, PoseMessage
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config import Config

WAIT_TO_PLAY_ONCE_NS = 120 * SECOND
_GRACE_NS, _WAIT_FOR_READERS_NS = SECOND // 2, int(2.5 * SECOND)


class Audience:
    """The other workers: whether they are there, have found the objects, and have read the last frame. Each
    subscription ends as soon as its question is answered."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._bus = bus
        self.missing = {str(worker) for worker in (*config.workers, *config.far) if worker != "camera"}
        self._not_acquired = {item.name for item in config.objects}
        self._read: tuple[int | None, int | None] = (None, None)
        reads = config.camera.once and "tracker" in config.workers
        inbox, keys = bus.inbox, config.keys
        self._live = inbox.liveliness(keys.live()) if self.missing else None
        self._poses = inbox.queue(keys.poses, wakes=False) if reads and config.objects else None
        self._health = inbox.queue(keys.health("tracker"), wakes=False) if reads else None

    def may_begin(self, impatient: bool) -> bool:
        """Whether every worker is there. impatient: wait no longer, and begin without the missing ones."""
        while self._live is not None and (worker := self._bus.take_begun(self._live)) is not None:
            self.missing.discard(worker)
        if self.missing and impatient:
            self._bus.log.say(f"playing without {', '.join(sorted(self.missing))}")
            self.missing.clear()
        if self._live is not None and not self.missing:
            self._bus.inbox.forget(self._live)
            self._live = None
        return not self.missing

    def has_acquired_all(self) -> bool:
        """Whether every configured object has had a pose; False if none is named."""
        while self._poses is not None and (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            if pose.translation is not None:
                self._not_acquired.discard(pose.object)
        return self._poses is not None and not self._not_acquired

    def ignore_poses(self) -> None:
        """End the subscription to poses, after the first frame."""
        if self._poses is not None:
            self._bus.inbox.forget(self._poses)
            self._poses = None

    def is_done(self, camera_epoch: int, frame_id: int, since_ns: int) -> bool:
        """Whether the tracker has read the last frame, or the time to wait for it is over. since_ns: time
        since the frame was published."""
        while self._health is not None and (news := self._bus.take(self._health, HealthMessage)) is not None:
            self._read = (news.camera_epoch, news.frame_id)
        wait_ns = _GRACE_NS if self._health is None else _WAIT_FOR_READERS_NS
        return self._read == (camera_epoch, frame_id) or since_ns > wait_ns
