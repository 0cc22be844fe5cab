"""The poses of a frame, which come one by one, until all are there. No clock in here: times are passed in."""

from __future__ import annotations

from huepose_protos.messages import PoseMessage
from huepose_services.convert import frame_key
from huepose_services.runtime.clock import SECOND

_QUIET_NS = SECOND // 40
"""So long after the last pose of a frame no other one is waited for."""
_LONGEST_NS = SECOND // 10
"""So long after the first one in no case."""
_LIVING_NS = SECOND

_Instance = tuple[str, int]


class Together:
    """What is said of one frame. The tracker says of each instance in every frame where it is, or that it is
    lost: the frame is `complete` when all that spoke within a second before have spoken of it, and no new
    one, which may bring others. Until then it is told when a pose of another frame comes (`ends_with`), or
    at `due_ns`."""

    def __init__(self) -> None:
        self._frame = (-1, -1)
        self._poses: dict[_Instance, PoseMessage] = {}
        self._spoke_ns: dict[_Instance, int] = {}
        self._awaited: set[_Instance] = set()
        self._first_ns = self._last_ns = 0
        self._untold = False

    def ends_with(self, pose: PoseMessage) -> bool:
        """Whether a pose is of another frame, while there is something to tell of this one."""
        return self._untold and frame_key(pose) != self._frame

    def add(self, pose: PoseMessage, now_ns: int) -> None:
        """Take a pose, of any state. One that comes after its frame was told lets it be told again, whole."""
        if frame_key(pose) != self._frame:
            self._begin(pose)
        instance = (pose.object, pose.instance)
        self._poses[instance], self._spoke_ns[instance] = pose, pose.capture_ns
        if not self._untold:
            self._first_ns = now_ns
        self._last_ns = now_ns
        self._untold = (self._untold or pose.state == "TRACKING") and bool(self._tracked)

    def _begin(self, pose: PoseMessage) -> None:
        """The frame of a pose."""
        frame, at_ns = frame_key(pose), pose.capture_ns
        spoke_ns = self._spoke_ns if frame[0] == self._frame[0] else {}
        self._spoke_ns = {one: ns for one, ns in spoke_ns.items() if abs(at_ns - ns) < _LIVING_NS}
        self._frame, self._poses, self._untold = frame, {}, False
        self._awaited = set(self._spoke_ns)

    @property
    def complete(self) -> bool:
        """Whether there is something to tell, and nobody is waited for."""
        return self._untold and self._poses.keys() == self._awaited

    @property
    def due_ns(self) -> int | None:
        """When to tell it, complete or not; None where there is nothing to tell."""
        return min(self._last_ns + _QUIET_NS, self._first_ns + _LONGEST_NS) if self._untold else None

    def tell(self) -> list[PoseMessage]:
        """The poses of the frame that are TRACKING; one or more, where there is something to tell."""
        self._untold = False
        return self._tracked

    @property
    def _tracked(self) -> list[PoseMessage]:
        return [pose for pose in self._poses.values() if pose.state == "TRACKING"]
