"""Collect the poses of a frame, which come one by one. It has no clock: the caller passes the time."""

from __future__ import annotations

from huepose_protos.messages import PoseMessage
from huepose_services.convert import frame_key
from huepose_services.runtime.clock import SECOND

_QUIET_NS = SECOND // 40
"""The longest wait for another pose, from the last pose of a frame."""
_LONGEST_NS = SECOND // 10
"""The longest wait in total, from the first pose of a frame."""
_LIVING_NS = SECOND

_Instance = tuple[str, int]


class Together:
    """The poses of one frame, to be published together. In every frame the tracker publishes a message for
    each instance, also for lost ones. The frame is `complete` when the instances with a message in it are
    exactly those of the last second: after a new one, others may follow. Otherwise its poses are due when a
    pose of another frame comes (`ends_with`), or at `due_ns`."""

    def __init__(self) -> None:
        self._frame = (-1, -1)
        self._poses: dict[_Instance, PoseMessage] = {}
        self._captured_ns: dict[_Instance, int] = {}
        self._awaited: set[_Instance] = set()
        self._first_ns = self._last_ns = 0
        self._unpublished = False

    def ends_with(self, pose: PoseMessage) -> bool:
        """Whether a pose is of another frame, while poses of this one are unpublished."""
        return self._unpublished and frame_key(pose) != self._frame

    def add(self, pose: PoseMessage, now_ns: int) -> None:
        """Add a pose in any state. If its frame was published already, the whole frame becomes due
        again."""
        if frame_key(pose) != self._frame:
            self._begin(pose)
        instance = (pose.object, pose.instance)
        self._poses[instance], self._captured_ns[instance] = pose, pose.capture_ns
        if not self._unpublished:
            self._first_ns = now_ns
        self._last_ns = now_ns
        self._unpublished = (self._unpublished or pose.state == "TRACKING") and bool(self._tracked)

    def _begin(self, pose: PoseMessage) -> None:
        """Begin with the frame of a pose."""
        frame, at_ns = frame_key(pose), pose.capture_ns
        captured_ns = self._captured_ns if frame[0] == self._frame[0] else {}
        self._captured_ns = {one: ns for one, ns in captured_ns.items() if abs(at_ns - ns) < _LIVING_NS}
        self._frame, self._poses, self._unpublished = frame, {}, False
        self._awaited = set(self._captured_ns)

    @property
    def complete(self) -> bool:
        """Whether poses are unpublished, and no other pose of the frame is expected."""
        return self._unpublished and self._poses.keys() == self._awaited

    @property
    def due_ns(self) -> int | None:
        """When to publish the frame, complete or not; None if nothing is unpublished."""
        return min(self._last_ns + _QUIET_NS, self._first_ns + _LONGEST_NS) if self._unpublished else None

    def take(self) -> list[PoseMessage]:
        """Take the poses of the frame that are TRACKING; one or more, if any are unpublished."""
        self._unpublished = False
        return self._tracked

    @property
    def _tracked(self) -> list[PoseMessage]:
        return [pose for pose in self._poses.values() if pose.state == "TRACKING"]
