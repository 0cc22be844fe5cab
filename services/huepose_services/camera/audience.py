"""Who looks at what a camera plays: with them it begins, and it ends when they have read the last frame."""

from __future__ import annotations

from huepose_protos.keys import last
from huepose_protos.messages import HealthMessage, PoseMessage
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config import Config

WAIT_TO_PLAY_ONCE_NS = 120 * SECOND
_GRACE_NS, _WAIT_FOR_READERS_NS = SECOND // 2, int(2.5 * SECOND)


class Audience:
    """The other workers: whether they are connected, have found the objects, and have read the last frame.
    Each subscription ends as soon as its answer is known."""

    def __init__(self, bus: Bus, config: Config) -> None:
        self._bus = bus
        self.missing = {str(worker) for worker in (*config.workers, *config.far) if worker != "camera"}
        self._not_acquired = {item.name for item in config.objects}
        self._read: tuple[int | None, int | None] = (None, None)
        self.reads = config.camera.once and "tracker" in config.workers
        inbox, keys = bus.inbox, config.keys
        self._live = inbox.liveliness(keys.live()) if self.missing else None
        self._poses = inbox.queue(keys.poses, wakes=False) if self.reads and config.objects else None
        self._health = inbox.queue(keys.health("tracker"), wakes=False) if self.reads else None

    def complete(self) -> bool:
        """Whether every worker has been connected."""
        while self._live is not None and (sample := self._live.take()) is not None:
            self.missing.discard(last(str(sample.key_expr)))
        if self._live is not None and not self.missing:
            self._bus.inbox.forget(self._live)
            self._live = None
        return not self.missing

    def may_begin(self, impatient: bool) -> bool:
        """Whether every worker is there, or is waited for no longer."""
        if not self.complete() and impatient:
            self._bus.log.say(f"playing without {', '.join(sorted(self.missing))}")
            self.missing.clear()
        return self.complete()

    def has_acquired_all(self) -> bool:
        """Whether every object that is looked for by name has had a pose."""
        while self._poses is not None and (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            if pose.translation is not None:
                self._not_acquired.discard(pose.object)
        return self._poses is not None and not self._not_acquired

    def ignore_poses(self) -> None:
        """End the subscription to poses: the first frame is over."""
        if self._poses is not None:
            self._bus.inbox.forget(self._poses)
            self._poses = None

    def has_read(self, camera_epoch: int, frame_id: int) -> bool:
        """Whether the tracker says that this frame was its last."""
        while self._health is not None and (said := self._bus.take(self._health, HealthMessage)) is not None:
            self._read = (said.camera_epoch, said.frame_id)
        return self._read == (camera_epoch, frame_id)

    def is_done(self, camera_epoch: int, frame_id: int, since_ns: int) -> bool:
        """Whether the last frame was read, or time enough has gone by since it was published."""
        read = self.has_read(camera_epoch, frame_id) if self.reads else since_ns > _GRACE_NS
        return read or since_ns > _WAIT_FOR_READERS_NS
