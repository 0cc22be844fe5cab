"""Depth cameras through OpenCV: those of Orbbec, by its backend CAP_OBSENSOR.

Depth is brought into the pixels of colour by the camera. Both come one by one, without stamps that say when
they were captured: they are stamped on arrival. OpenCV must have been built with that backend; the wheels of
PyPI are not.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry import Camera
from huepose.support.errors import InputError
from huepose_services.camera.live import REPLUG, CameraError, LiveSource, Shot
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig

_NO_DEPTH = (
    "A webcam has no depth, and HuePose needs depth in every pixel: use a depth camera with camera.source "
    "realsense or oak, or with your driver's own package by python (docs/cameras.md)"
)
_LOOK_AGAIN_S = 0.002


def open_source(config: Config) -> LiveSource:
    """The camera of the configuration, not opened. Raises InputError where OpenCV cannot read any depth."""
    if not cv2.videoio_registry.hasBackend(cv2.CAP_OBSENSOR):
        raise InputError(
            "camera.source opencv",
            found=f"OpenCV {cv2.__version__} for webcams only, without its backend OBSENSOR",
            expected="one built with -D WITH_OBSENSOR=ON, which reads depth cameras of Orbbec",
            fix=f"{_NO_DEPTH}; of Orbbec's that is pyorbbecsdk.",
        )
    return source_of(config.camera)


def source_of(settings: CameraConfig, capture: Callable[..., Any] = cv2.VideoCapture) -> LiveSource:
    """One camera, by its place among those that OpenCV finds. capture: what opens it."""
    index = settings.device.index

    def start() -> OpenCvCamera:
        opened = capture(index, cv2.CAP_OBSENSOR)
        if not opened.isOpened():
            there = Path(f"/dev/video{index}")
            other = f" What is at {there} is another camera. {_NO_DEPTH}." if there.exists() else ""
            raise CameraError(f"OpenCV finds no depth camera of Orbbec: plug it into a USB 3 port.{other}")
        try:
            return OpenCvCamera(opened, settings)
        except CameraError:
            opened.release()
            raise

    return LiveSource(f"OpenCV {index}", REPLUG, start)


class OpenCvCamera:
    """An open device."""

    device_clock_is_host = True
    is_sensor = True

    def __init__(self, capture: Any, settings: CameraConfig) -> None:
        self._capture, self._number = capture, 0
        self._apart_ns = SECOND / float(settings.rate) / 2
        focal = (cv2.CAP_PROP_OBSENSOR_INTRINSIC_FX, cv2.CAP_PROP_OBSENSOR_INTRINSIC_FY)
        middle = (cv2.CAP_PROP_OBSENSOR_INTRINSIC_CX, cv2.CAP_PROP_OBSENSOR_INTRINSIC_CY)
        told = tuple(float(capture.get(key)) for key in (*focal, *middle))
        self._fx, self._fy, self._cx, self._cy = settings.device.intrinsics or told
        if not (self._fx > 0 and self._fy > 0):
            raise CameraError(
                "it does not tell its intrinsics: set camera.device.intrinsics to [fx, fy, cx, cy]."
            )
        self._held: dict[int, tuple[int, Any]] = {}
        self._stamp: float | None = None

    def read(self, timeout_s: float) -> Shot | None:
        """The next colour picture with the depth of its time; None when none came in time."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if self._capture.grab() and self._is_new():
                arrived_ns = now_ns()
                for kind in (cv2.CAP_OBSENSOR_BGR_IMAGE, cv2.CAP_OBSENSOR_DEPTH_MAP):
                    there, image = self._capture.retrieve(flag=kind)
                    if there:
                        self._held[kind] = (arrived_ns, image)
                stamps = [at_ns for at_ns, _ in self._held.values()]
                if len(stamps) == 2 and max(stamps) - min(stamps) <= self._apart_ns:
                    return self._shot(arrived_ns)
            time.sleep(_LOOK_AGAIN_S)
        return None

    def _is_new(self) -> bool:
        """Some builds grab a picture again and again; those that do not have no stamps (0)."""
        last, self._stamp = self._stamp, self._capture.get(cv2.CAP_PROP_POS_MSEC)
        return not self._stamp or self._stamp != last

    def _shot(self, arrived_ns: int) -> Shot:
        (color_ns, color), (depth_ns, depth) = (
            self._held.pop(kind) for kind in (cv2.CAP_OBSENSOR_BGR_IMAGE, cv2.CAP_OBSENSOR_DEPTH_MAP)
        )
        height, width = color.shape[:2]
        if depth.shape != (height, width) or depth.dtype != np.uint16:
            found = f"{depth.shape[1]} x {depth.shape[0]} {depth.dtype}"
            raise CameraError(
                f"depth is {found}, colour {width} x {height}: it is not in the pixels of colour."
            )
        self._number += 1
        return Shot(
            color=np.ascontiguousarray(color[..., ::-1]),
            depth=depth.astype(np.float32) * np.float32(0.001),
            camera=Camera(self._fx, self._fy, self._cx, self._cy, width, height),
            number=self._number,
            device_ns=color_ns,
            depth_ns=depth_ns,
            arrived_ns=arrived_ns,
        )

    def close(self) -> None:
        """Let the device go."""
        self._capture.release()
