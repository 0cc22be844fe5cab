"""What a live camera is to the worker: something that is opened, read for a limited time, and closed.

A source is made without touching the device. `open` says at once when the device is not there; `read` returns
within its timeout. Both may still hang inside a vendor's SDK: `reader.Reader` therefore runs them in a thread
that nobody waits for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, TypeVar

from huepose.datasets.types import GroundTruth
from huepose.geometry import Camera
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.geometry.picture_faults import same
from huepose.support.errors import InputError
from huepose.support.extras import install_command

Device = TypeVar("Device")


@dataclass(frozen=True, eq=False)
class Shot:
    """One picture of a live camera, rectified, depth in the pixels of colour.

    color (H, W, 3) uint8 RGB; depth (H, W) float32 metres, 0 for no reading; number: the device's own count;
    device_ns: capture time on the device's clock, of colour; depth_ns: that of depth, None where it is not
    known; arrived_ns: CLOCK_MONOTONIC when this machine had it; truths: of a camera that knows them;
    T_parent_cam: as in an RgbdFrame, of one that knows where it is.
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
        """Whether every pixel is the same: no sensor gives one picture twice, but of nothing at all."""
        return same(self.color, other.color) and same(self.depth, other.depth) and bool(self.color.any())


REPLUG = "Close other programs that use it; else unplug it and plug it in again."


class CameraError(RuntimeError):
    """The camera cannot give pictures now: what was found, and what to do. It is tried again."""


class FilmOver(Exception):  # noqa: N818 - no error
    """A source that is played once has given its last picture."""


class LiveCamera(Protocol):
    """An open camera."""

    device_clock_is_host: bool
    """Whether `device_ns` is CLOCK_MONOTONIC already, because the SDK converts it."""

    is_sensor: bool
    """Whether no two pictures are the same but by a fault, as those of every sensor."""

    def read(self, timeout_s: float) -> Shot | None:
        """The next picture; None when none came in time. Raises CameraError when it is gone."""
        ...

    def close(self) -> None:
        """Let the device go."""
        ...


@dataclass(frozen=True)
class LiveSource:
    """A camera that may be there or not. if_silent: what to do where it gives no picture, in a sentence;
    open: starts it, and raises CameraError, in under two seconds when it is not there."""

    name: str
    if_silent: str
    open: Callable[[], LiveCamera]
    once: bool = False
    """Whether it is opened once: what goes wrong with it is then its end."""


def sdk(package: str, source: str, what: str, more: str = "") -> Any:
    """The package by which a source is read; what: it is; more: to install. Raises InputError without it."""
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
    """The camera of a serial number, or the only one. Raises CameraError: `if_none` where there is none."""
    if not connected:
        raise CameraError(if_none)
    names = ", ".join(connected)
    if serial is None and len(connected) > 1:
        raise CameraError(f"several are connected: set camera.device.serial to one of {names}.")
    if serial is not None and serial not in connected:
        raise CameraError(f"no camera with serial number {serial}; connected: {names}.")
    return next(iter(connected.values())) if serial is None else connected[serial]
