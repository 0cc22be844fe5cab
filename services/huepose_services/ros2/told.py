"""Tells the camera of a pipeline where it is, as the transforms of ROS 2 say (`camera.tf`)."""

from __future__ import annotations

from functools import partial

from huepose_protos.messages import MountMessage
from huepose_services.ros2.messages import TRANSFORMS, transforms_in
from huepose_services.ros2.publisher import Node
from huepose_services.ros2.tree import Tree
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns, this_clock
from huepose_services.runtime.config_perception import TfConfig
from huepose_services.runtime.inbox import Place

EVERY_NS = SECOND // 20
"""So often a place is told that only static transforms give: it holds at any time."""
_LATE_NS = SECOND // 2
_MOST_NAMES = 12


class CameraTold:
    """Listens to /tf and /tf_static, and says on the bus where `tf.child` is in `tf.parent`."""

    def __init__(self, bus: Bus, tf: TfConfig) -> None:
        self._bus, self._tf = bus, tf
        self._tree = Tree(tf.parent, tf.child)
        self._heard: tuple[tuple[Place, bool], ...] = ()
        self._said_ns = now_ns()
        self._due_ns = 0

    def listen(self, node: Node) -> None:
        """From now on; once."""
        if not self._heard:
            static = node.listen(self._bus.inbox, "/tf_static", TRANSFORMS, kept=True)
            self._heard = (static, True), (node.listen(self._bus.inbox, "/tf", TRANSFORMS, kept=False), False)

    @property
    def due_ns(self) -> int | None:
        """When a place that stands still is told again; None before anything is heard."""
        return self._due_ns if self._heard else None

    def step(self) -> None:
        """Take what arrived and tell the newest place; warn where there is none."""
        now, offset_ns = now_ns(), this_clock().realtime_offset_ns
        for place, static in self._heard:
            while (sample := place.take()) is not None:
                refuse = partial(self._bus.refuse, str(sample.key_expr))
                self._tree.take(transforms_in(sample.payload.to_bytes(), refuse), static)
        if now < self._due_ns and not self._tree.moving:
            return
        self._due_ns = now + EVERY_NS
        newest = self._tree.newest(now + offset_ns)
        if newest is not None:
            self._said_ns, stamp_ns = now, newest[0] - offset_ns
            late_s = (now - stamp_ns) / SECOND
            self._bus.health.warn_while("tf late", None if abs(now - stamp_ns) < _LATE_NS else _late(late_s))
            if 0 < stamp_ns < now + _LATE_NS:
                message = MountMessage(publish_ns=now, capture_ns=stamp_ns, mount=newest[1])
                self._bus.put(self._bus.keys.mount, message)
        silent = now - self._said_ns > _LATE_NS
        self._bus.health.warn_while("tf", self._missing() if silent else None)

    def _missing(self) -> str:
        way = f"{self._tf.child} in {self._tf.parent} (camera.tf)"
        if self._tree.known:
            return f"nothing new was said on /tf about {way} for half a second"
        names = self._tree.frames
        heard = ", ".join(names[:_MOST_NAMES]) + (" ..." if len(names) > _MOST_NAMES else "") or "none"
        return f"/tf and /tf_static do not say where {way} is; frames heard of: {heard}"


def _late(seconds: float) -> str:
    when = f"{seconds:.1f} s ago" if seconds > 0 else f"{-seconds:.1f} s from now"
    return (
        f"the newest transforms of /tf are stamped {when} by this computer's clock: the robot's clock has to "
        "agree with it (chrony, PTP), and must not be that of a simulation"
    )
