"""Sends a pipeline the pose of its moving camera, on the pipeline's own machine and as its user.

>>> with MountSender("base_link") as sender:                # doctest: +SKIP
...     while True:
...         sender.tell(robot.T_base_tool())                # as often as the robot knows it
"""

from __future__ import annotations

import time

import zenoh
from numpy.typing import ArrayLike

from huepose_protos.client import open_session
from huepose_protos.codec import encode
from huepose_protos.keys import Keys
from huepose_protos.local import Whereabouts, endpoint
from huepose_protos.messages import MountMessage
from huepose_protos.motion import SECOND, mount_of, quaternion_from, rigid

_OLDEST_NS = 10 * SECOND
"""The pose of an arm is sent a few milliseconds old; a much older timestamp is of another clock."""


class MountSender:
    """Sends to the camera of a pipeline with `camera.moving`; it may be made before the pipeline runs.

    parent: the frame of the robot or room that the transforms are in; site, camera: of the pipeline;
    base_port: its `bus.base_port`, by default that of the pipeline of this camera that runs here, looked up
    again every second. Raises ValueError if several of that name run."""

    def __init__(
        self, parent: str, site: str = "local", camera: str = "cam0", base_port: int | None = None
    ) -> None:
        self._parent, self._key = parent, Keys(site, camera).mount
        self._place = Whereabouts(site, camera) if base_port is None else None
        self._session = _session_at(base_port if self._place is None else self._place.port)

    def tell(self, T_parent: ArrayLike, stamp_ns: int | None = None) -> None:
        """Send the pose (4, 4) in `parent` of the frame `camera.mount.parent`, or, without `camera.mount`,
        of the camera's optical frame. stamp_ns: its time on this machine's CLOCK_MONOTONIC, by default now.
        Raises ValueError if it is no rigid motion, and for a timestamp of another clock."""
        T, now = rigid(T_parent), time.monotonic_ns()
        stamp_ns = now if stamp_ns is None else int(stamp_ns)
        if not now - _OLDEST_NS <= stamp_ns <= now + SECOND:
            raise ValueError(
                f"stamp_ns {stamp_ns} is {(stamp_ns - now) / SECOND:+.1f} s from now: give the "
                "time.monotonic_ns() at which the robot was there, not time.time_ns()"
            )
        mount = mount_of(self._parent, T[:3, 3], quaternion_from(T[:3, :3]))
        if self._place is not None and self._place.has_moved():
            self._session.close()
            self._session = _session_at(self._place.port)
        message = MountMessage(publish_ns=now, capture_ns=stamp_ns, mount=mount)
        self._session.put(self._key, encode(message))

    def close(self) -> None:
        """Disconnect from the bus."""
        self._session.close()

    def __enter__(self) -> MountSender:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _session_at(port: int | None) -> zenoh.Session:
    return open_session([] if port is None else [endpoint(port)])
