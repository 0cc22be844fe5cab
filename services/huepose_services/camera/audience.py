"""The subscribers of a camera: whether they are connected, whether they have found the objects, what they
have read."""

from __future__ import annotations

from huepose_protos.keys import last
from huepose_protos.messages import HealthMessage, PoseMessage
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.config import Config


class Audience:
    """The other workers, as the bus shows them. What is over is listened to no longer."""

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
        """Whether all have been there."""
        while self._live is not None and (sample := self._live.take()) is not None:
            self.missing.discard(last(str(sample.key_expr)))
        if self._live is not None and not self.missing:
            self._bus.inbox.forget(self._live)
            self._live = None
        return not self.missing

    def begin_without(self) -> None:
        """Wait for nobody any more."""
        self.missing.clear()
        self.complete()

    def has_acquired_all(self) -> bool:
        """Whether every object that is looked for by name has had a pose."""
        while self._poses is not None and (pose := self._bus.take(self._poses, PoseMessage)) is not None:
            if pose.translation is not None:
                self._not_acquired.discard(pose.object)
        return self._poses is not None and not self._not_acquired

    def ignore_poses(self) -> None:
        """The first frame is over."""
        if self._poses is not None:
            self._bus.inbox.forget(self._poses)
            self._poses = None

    def has_read(self, camera_epoch: int, frame_id: int) -> bool:
        """Whether the tracker says that this frame was its last."""
        while self._health is not None and (said := self._bus.take(self._health, HealthMessage)) is not None:
            self._read = (said.camera_epoch, said.frame_id)
        return self._read == (camera_epoch, frame_id)
