"""Detect a camera whose depth and colour are not captured at the same time, from moving objects.

With an object at rest such a camera shows no fault, and the pose is right.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import msgspec
import numpy as np

from huepose.estimation.depth_delay import DepthDelay, EdgeLag, delay, edge_lag
from huepose.geometry import RgbdFrame
from huepose.tracking import TrackedPose, Tracker
from huepose.tracking.motion import about_centre
from huepose_services.runtime.clock import SECOND

LOOKS = 60
"""How many looks (measurements of the delay) are kept; the newest count."""

LOOK_EVERY_NS, BLOCK_NS = SECOND // 20, SECOND // 6
"""The least time from one look to the next; and the length of a block: looks at one object within a block
have correlated errors. So have looks at one image that comes again and again."""

REST, REST_NS = 0.3, SECOND
"""An object is at rest if it has moved by less than REST of its diameter a second, for REST_NS."""

WAY_OUT = (
    "Therefore moving objects are not TRACKING, nor for a second after they moved. Synchronise the two "
    "cameras, or pair their images by their timestamps. If you are sure that all is right, set camera.check: "
    "false."
)


class DelayDoubt(msgspec.Struct, array_like=True):
    """The looks in the newest camera epoch, and what follows from them. looks, blocks: as for `delay`;
    looked_ns, moved_ns: when each instance ("object/number") was last looked at, and when it last moved;
    images: of each look, a checksum; time: number of the newest look's block;
    found: the delay and its standard error, seconds, and the share of looks that agree; None if the camera
    seems right."""

    epoch: int = -1
    looks: list[EdgeLag] = []
    blocks: list[str] = []
    looked_ns: dict[str, int] = {}
    moved_ns: dict[str, int] = {}
    found: tuple[float, float, float] | None = None
    images: list[int] = []
    time: int = -1

    @property
    def text(self) -> str:
        """What is wrong with the camera; empty if nothing is."""
        return "" if self.found is None else DepthDelay(*self.found).said()

    def look(self, frame: RgbdFrame, poses: Sequence[TrackedPose], tracker: Tracker) -> str | None:
        """Look at one object of a frame, LOOK_EVERY_NS after the last look: of the objects that move
        according to their tracked poses, the one whose last look is longest ago. Returns what is wrong with
        the camera and what to do; None if nothing is."""
        if frame.epoch != self.epoch:
            self.epoch, self.found = frame.epoch, None
            self.looks, self.blocks, self.looked_ns, self.moved_ns, self.images = [], [], {}, {}, []
        now, moving = frame.stamp_ns, {_key(pose): pose for pose in poses if _moves(pose, tracker)}
        here = set(map(_key, poses))
        self.looked_ns = {key: at_ns for key, at_ns in self.looked_ns.items() if key in here}
        self.moved_ns = {key: at_ns for key, at_ns in self.moved_ns.items() if key in here}
        self.moved_ns |= dict.fromkeys(moving, now)
        since = {key: abs(now - self.looked_ns.get(key, now - SECOND)) for key in moving}
        key = max(since, key=lambda key: since[key], default="")
        if key and min(since.values()) >= LOOK_EVERY_NS:
            self.looked_ns[key] = now
            self._look_at(frame, moving[key], tracker)
        return f"{self.text} {WAY_OUT}" if self.text else None

    def _look_at(self, frame: RgbdFrame, pose: TrackedPose, tracker: Tracker) -> None:
        assert pose.T_cam_obj is not None
        assert pose.velocity is not None
        one = edge_lag(tracker.contours(pose.object), pose.T_cam_obj, pose.velocity, frame)
        if one is not None:
            self._add(one, _key(pose), frame)

    def _add(self, one: EdgeLag, key: str, frame: RgbdFrame) -> None:
        """Keep a look; fit the delay again when a new block begins."""
        begun, self.time = frame.stamp_ns // BLOCK_NS != self.time, frame.stamp_ns // BLOCK_NS
        image = zlib.crc32(frame.color[::4, ::4].tobytes())
        # From the newest on: a memory of an older version has blocks without images.
        known = dict(zip(self.images[::-1], self.blocks[::-1], strict=False))
        block = known.get(image, f"{key} {self.time}")
        self.looks, self.images = [*self.looks, one][-LOOKS:], [*self.images, image][-LOOKS:]
        self.blocks = [*self.blocks, block][-LOOKS:]
        fit = delay(self.looks, self.blocks) if begun else None
        if fit is not None and fit.clear:
            self.found = (fit.seconds, fit.error_s, fit.share)
        elif fit is not None and fit.none:
            self.found = None

    def of(self, pose: TrackedPose) -> str:
        """What is wrong with a pose because of the delay; empty for an object at rest."""
        moved_ns = self.moved_ns.get(_key(pose))
        at_rest = moved_ns is None or abs(pose.stamp_ns - moved_ns) > REST_NS
        return "" if pose.T_cam_obj is None or at_rest else self.text


def _key(pose: TrackedPose) -> str:
    return f"{pose.object}/{pose.instance}"


def _moves(pose: TrackedPose, tracker: Tracker) -> bool:
    if pose.T_cam_obj is None or pose.velocity is None:
        return False
    surface = tracker.surface(pose.object)
    velocity = about_centre(surface, pose.T_cam_obj, pose.velocity)
    m_s = np.linalg.norm(velocity[:3]) + 0.5 * surface.diameter_m * np.linalg.norm(velocity[3:])
    return bool(m_s > REST * surface.diameter_m)
