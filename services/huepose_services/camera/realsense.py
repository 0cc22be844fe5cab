"""RealSense cameras through pyrealsense2, and the `.db3` recordings of its recorder.

The device's sensors are opened one by one and joined by the SDK's syncer, not by its pipeline, which blocks
for 15 s where no camera is: so a real camera, a recording and the SDK's software device run the same lines.
Depth is brought into the colour picture's pixels, then both are rectified.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from huepose.support.errors import InputError
from huepose_services.camera.live import REPLUG, CameraError, LiveSource, Shot, sdk, the_one
from huepose_services.camera.realsense_setup import (
    Rectification,
    apply_options,
    chosen_profiles,
    made_filters,
    use_own_clock,
)
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig


def open_source(config: Config) -> LiveSource:
    """The camera of the configuration, not opened. Raises InputError without the SDK or the recording."""
    rs = sdk("pyrealsense2", "realsense", "Intel's SDK for Python", ", and libusb-1.0-0 by apt-get")
    path = config.camera.path
    if path is not None and not (Path(path).is_file() and path.endswith((".db3", ".bag"))):
        raise InputError(
            f"camera.path {path}",
            found="no such recording",
            expected="a .db3 file of the RealSense recorder",
            fix="Give its path, or null for the camera itself.",
        )
    return source_of(rs, config.camera)


# A set of colour and depth may be followed by one of colour alone: it must not push the other out.
_QUEUE = 2


_NONE = (
    "no RealSense camera is connected. Plug it into a USB 3 port; if `lsusb -d 8086:` lists it, install the "
    "udev rules (deploy/jetson/install.sh --udev) and plug it in again."
)


def source_of(rs: Any, settings: CameraConfig) -> LiveSource:
    """One camera, by serial number, or the only one; or a recording, from its start."""
    context, path, serial = rs.context(), settings.path, settings.device.serial

    def device() -> Any:
        if path is not None:
            # The SDK keeps a recording that it has played until it is told otherwise.
            with suppress(RuntimeError):
                context.unload_device(path)
            return context.load_device(path)
        # A camera that is starting, or used by another program, may be listed and not answer.
        serial_of = rs.camera_info.serial_number
        devices = {d.get_info(serial_of): d for d in context.query_devices() if d.supports(serial_of)}
        return the_one(devices, serial, _NONE)

    place = Path(path).name if path else serial
    name = f"RealSense {place}" if place else "RealSense"
    return LiveSource(name, REPLUG, lambda: RealSenseCamera(rs, device(), settings))


class RealSenseCamera:
    """An open device of any kind that the SDK knows."""

    device_clock_is_host = False
    is_sensor = True

    def __init__(self, rs: Any, device: Any, settings: CameraConfig) -> None:
        self._rs, self._device = rs, device
        self._recorded = device.is_playback()
        sensors = list(device.query_sensors())
        chosen = chosen_profiles(rs, sensors, settings, any_rate=self._recorded)
        if not self._recorded:
            use_own_clock(rs, sensors)
            apply_options(rs, sensors, settings.device.options)
        self._filters = made_filters(rs, settings.device.filters)
        self._align = rs.align(rs.stream.color) if settings.device.align else None
        self._syncer = rs.syncer(_QUEUE)
        self._rectification: Rectification | None = None
        self._open: list[Any] = []
        try:
            for sensor, profiles in chosen:
                sensor.open(profiles)
                self._open.append(sensor)
            for sensor in self._open:
                sensor.start(self._syncer)
        except RuntimeError as error:
            self.close()
            raise CameraError(f"it does not start: {error}. Is another program using it?") from None

    def read(self, timeout_s: float) -> Shot | None:
        """The next picture with both colour and depth; None when none came in time."""
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            there, frames = self._syncer.try_wait_for_frames(max(int(left_s * 1000), 1))
            arrived_ns = now_ns()
            if not there:
                break
            frameset = frames.as_frameset()
            # While one of its sensors starts, or when USB lost a picture, a set holds only the other one.
            if frameset.get_depth_frame() and frameset.get_color_frame():
                return self._shot(frameset, arrived_ns)
        if self._recorded and self._device.as_playback().current_status() == self._rs.playback_status.stopped:
            raise CameraError("the recording has ended; it is played again.")
        return None

    def _shot(self, frameset: Any, arrived_ns: int) -> Shot:
        color, depth = frameset.get_color_frame(), frameset.get_depth_frame()
        # Stamps of two clocks say nothing of each other.
        one_clock = color.get_frame_timestamp_domain() == depth.get_frame_timestamp_domain()
        depth_ns = round(depth.get_timestamp() * 1e6) if one_clock else None
        for one in self._filters:
            frameset = one.process(frameset).as_frameset()
        if self._align is not None:
            frameset = self._align.process(frameset).as_frameset()
        color, depth = frameset.get_color_frame(), frameset.get_depth_frame()
        intrinsics = color.get_profile().as_video_stream_profile().get_intrinsics()
        if (depth.get_width(), depth.get_height()) != (intrinsics.width, intrinsics.height):
            raise CameraError("depth is not in the pixels of colour: set camera.device.align to true.")
        if self._rectification is None:
            self._rectification = Rectification(self._rs, intrinsics)
        # Both must be copies: the SDK reuses the memory of its frames.
        metres = np.asarray(depth.get_data()).astype(np.float32) * np.float32(depth.get_units())
        return Shot(
            color=self._rectification.color(np.array(color.get_data())),
            depth=self._rectification.depth(metres),
            camera=self._rectification.camera,
            number=color.get_frame_number(),
            device_ns=round(color.get_timestamp() * 1e6),
            depth_ns=depth_ns,
            arrived_ns=arrived_ns,
        )

    def close(self) -> None:
        """Stop what was started."""
        for sensor in self._open:
            with suppress(RuntimeError):  # unplugged
                sensor.stop()
            with suppress(RuntimeError):
                sensor.close()
        self._open.clear()
