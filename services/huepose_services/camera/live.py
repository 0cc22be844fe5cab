"""The interface of live cameras: a camera is opened, read with a timeout, and closed.

A source is made without touching the device. `open` fails at once if the device is not there; `read`
returns within its timeout. Both may still hang inside a vendor's SDK: `reader.Reader` therefore runs them
in a thread that nobody waits for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, TypeVar

from huepose.datasets.types import GroundTruth
from huepose.geometry import Camera
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.geometry.image_faults import same
from huepose.support.errors import InputError
from huepose.support.extras import install_command

Device = TypeVar("Device")


@dataclass(frozen=True, eq=False)
class Shot:
    """One colour and depth image of a live camera, rectified, with depth in the pixels of colour.

    color (H, W, 3) uint8 RGB; depth (H, W) float32 metres, 0 for no reading; number: the device's own
    count; device_ns: capture time of colour on the device's clock; depth_ns: that of depth, None if it is
    not known; arrived_ns: CLOCK_MONOTONIC at the arrival on this machine; truths: ground truth, from a
    camera that knows it; T_parent_cam: as in an RgbdFrame, from a camera that knows its pose.
    """

    color: UInt8
    depth: Float32
    camera: Camera
    number: int
    device_ns: int
    arrived_ns: int
    depth_ns: int | None = None
    truths: tuple[GroundTruth, ...] = ()
    T_parent_cam: Float64 | None = None

    def shows_the_same(self, other: Shot) -> bool:
        """Whether every pixel is the same. A sensor never gives the same image twice; black images do not
        count."""
        return same(self.color, other.color) and same(self.depth, other.depth) and bool(self.color.any())


REPLUG = "Close other programs that use it; else unplug it and plug it in again."


class CameraError(RuntimeError):
    """The camera cannot give images now: what was found, and what to do. It is tried again."""


class SourceEnded(Exception):  # noqa: N818 - no error
    """A source that is played once has given its last image."""


class LiveCamera(Protocol):
    """An open camera."""

    device_clock_is_host: bool
    """Whether `device_ns` is CLOCK_MONOTONIC already, because the SDK converts it."""

    is_sensor: bool
    """Whether two equal images mean a fault, as with every real sensor."""

    def read(self, timeout_s: float) -> Shot | None:
        """The next image; None if none came in time. Raises CameraError if the camera is gone."""
        ...

    def close(self) -> None:
        """Close the device."""
        ...


@dataclass(frozen=True)
class LiveSource:
    """A camera that may be connected or not. if_silent: a sentence that says what to do if it gives no
    image; open: starts the camera; raises CameraError, in under two seconds if it is not there."""

    name: str
    if_silent: str
    open: Callable[[], LiveCamera]
    once: bool = False
    """Whether it is opened only once; then any error ends it."""


def sdk(package: str, source: str, what: str, more: str = "") -> Any:
    """Import the package that reads a source. what: a description of the package; more: what else to
    install. Raises InputError if it is not installed."""
    try:
        return import_module(package)
    except ImportError as error:
        raise InputError(
            f"camera.source {source}",
            found=f"no {package} ({error})",
            expected=what,
            fix=f"Install it: {install_command(source)}{more}.",
        ) from None


def the_one(connected: Mapping[str, Device], serial: str | None, if_none: str) -> Device:
    """The camera with a serial number, or the only one. Raises CameraError, with `if_none` if none is
    connected."""
    if not connected:
        raise CameraError(if_none)
    names = ", ".join(connected)
    if serial is None and len(connected) > 1:
        raise CameraError(f"several are connected: set camera.device.serial to one of {names}.")
    if serial is not None and serial not in connected:
        raise CameraError(f"no camera with serial number {serial}; connected: {names}.")
    return next(iter(connected.values())) if serial is None else connected[serial]
