"""The built-in scene as a live camera with faults that are ordered while it runs, for `huepose chaos`.

The orders are JSON in the file `camera.path`, read again when it changes. Like a real device, it has a
clock of its own.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import cv2
import msgspec
import numpy as np
from msgspec import Meta

from huepose.datasets.types import Scene
from huepose.geometry.arrays import Float32, UInt8
from huepose.support.errors import InputError
from huepose_services.camera.live import REPLUG, CameraError, LiveSource, Shot
from huepose_services.camera.synthetic import open_source as open_scene
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config

_BOOT_NS = 5 * SECOND
"""What the device's clock shows when it is opened."""


class Orders(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The faults of the camera; by default none."""

    unplugged: bool = False
    frozen: Literal["", "stamps", "pixels"] = ""
    """stamps: the last image for ever; pixels: the same image with new numbers and timestamps."""
    jump_s: float = 0.0
    """The device's clock is set forward by this."""
    drift: float = 0.0
    depth_late: Annotated[int, Meta(ge=0, le=30)] = 0
    """Depth is older than colour by this many images; its timestamp shows it."""
    depth: Literal["good", "zero", "nan", "inf", "largest", "holes"] = "good"
    dark: bool = False
    rate_share: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0
    half_size: bool = False
    focal_share: Annotated[float, Meta(gt=0.1, le=10.0)] = 1.0
    """Wrong intrinsics: this multiple of the right focal length."""


def open_source(config: Config) -> LiveSource:
    """The camera with the orders in `camera.path`. Raises InputError if these cannot be read."""
    assert config.camera.path is not None  # the configuration was checked
    orders = Path(config.camera.path)
    read_orders(orders)

    def start() -> FaultyCamera:
        if read_orders(orders).unplugged:
            raise CameraError("no camera is connected. Plug it in.")
        return FaultyCamera(orders, open_scene(config), float(config.camera.rate))

    return LiveSource("faulty camera", REPLUG, start)


def read_orders(path: Path) -> Orders:
    """The orders in a file. Raises InputError if it has none."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Orders)
    except (OSError, ValueError) as error:
        raise InputError(f"camera.path {path}", found=str(error)[:200], expected="orders in JSON") from None


class FaultyCamera:
    """Gives an image when it is due."""

    device_clock_is_host = False
    is_sensor = True

    def __init__(self, orders: Path, scene: Scene, rate_hz: float) -> None:
        self._path, self._scene, self._period_ns = orders, scene, SECOND / rate_hz
        self._orders, self._changed_ns = read_orders(orders), -1
        self._start_ns = self._due_ns = now_ns()
        self._last: Shot | None = None
        self._number = self._image = 0

    def _obey(self) -> Orders:
        changed_ns = self._path.stat().st_mtime_ns
        if changed_ns != self._changed_ns:
            self._orders, self._changed_ns = read_orders(self._path), changed_ns
        return self._orders

    def read(self, timeout_s: float) -> Shot | None:
        """The next image; None if none is due in time. Raises CameraError if it is unplugged."""
        orders = self._obey()
        if orders.unplugged:
            raise CameraError("the connection is lost. Check the cable; the search for the camera goes on.")
        wait_s = (self._due_ns - now_ns()) / SECOND
        time.sleep(min(max(wait_s, 0.0), timeout_s))
        if wait_s > timeout_s:
            return None
        # Images that nobody fetched in time are lost, as in a real camera.
        self._due_ns = max(self._due_ns, now_ns() - 2 * round(self._period_ns)) + round(
            self._period_ns / orders.rate_share
        )
        shot = self._shot(orders)
        if orders.frozen == "" or self._last is None:
            self._last = shot
        elif orders.frozen == "stamps":
            shot = self._last
        else:
            shot = replace(shot, color=self._last.color, depth=self._last.depth)
        return shot

    def _shot(self, orders: Orders) -> Shot:
        """The image of now, with the ordered faults."""
        passed_ns = now_ns() - self._start_ns
        image = self._image = max(round(passed_ns / self._period_ns), self._image + 1)
        self._number += 1
        late = min(orders.depth_late, image)
        device_ns = _BOOT_NS + round(passed_ns * (1.0 + orders.drift)) + round(orders.jump_s * SECOND)
        frame = self._scene.frame(image)
        color: UInt8 = np.zeros_like(frame.color) if orders.dark else frame.color
        depth = _spoilt(self._scene.frame(image - late).depth, orders.depth)
        camera = frame.camera
        if orders.half_size:
            small = cv2.resize(color, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            color, depth = np.asarray(small, np.uint8), depth[::2, ::2]
            camera = camera.scaled(0.5)
        if orders.focal_share != 1.0:
            camera = replace(camera, fx=camera.fx * orders.focal_share, fy=camera.fy * orders.focal_share)
        return Shot(
            color=np.ascontiguousarray(color),
            depth=np.ascontiguousarray(depth),
            camera=camera,
            number=self._number,
            device_ns=device_ns,
            depth_ns=device_ns - round(late * self._period_ns),
            arrived_ns=now_ns(),
            truths=self._scene.truths(image),
        )

    def close(self) -> None:
        """Do nothing: no device is open."""


def _spoilt(depth: Float32, how: str) -> Float32:
    """Depth (H, W) in metres as a faulty sensor gives it."""
    nothing = {"zero": 0.0, "nan": np.nan, "inf": np.inf, "largest": 6.5535}
    if how in nothing:
        return np.full_like(depth, nothing[how])
    if how == "holes":
        out = depth.copy()
        for place, value in enumerate(nothing.values()):
            # Each kind takes an eighth of the columns.
            out[:, place::8] = value
        return out
    return depth
