"""RealSense cameras through pyrealsense2, and the `.db3` recordings of its recorder.

The device's sensors are opened one by one and combined by the SDK's syncer, not by its pipeline, which
blocks for 15 s if there is no camera. So a real camera, a recording and the SDK's software device use the
same code. Depth is aligned to the colour image, then both are rectified.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets.rectify import Rectifier
from huepose.geometry import Camera
from huepose.support.errors import InputError
from huepose_services.camera.live import REPLUG, CameraError, LiveSource, Shot, sdk, the_one
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig, Filter

# A set of colour and depth may be followed by one of colour alone, which must not replace it in the queue.
_QUEUE = 2
_NONE = (
    "no RealSense camera is connected. Plug it into a USB 3 port; if `lsusb -d 8086:` lists it, install the "
    "udev rules (deploy/jetson/install.sh --udev) and plug it in again."
)


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


def source_of(rs: Any, settings: CameraConfig) -> LiveSource:
    """One camera, by serial number, or the only one; or a recording, from its start."""
    context, path, serial = rs.context(), settings.path, settings.device.serial

    def device() -> Any:
        if path is not None:
            # The SDK keeps a recording that it has played until it is unloaded.
            with suppress(RuntimeError):
                context.unload_device(path)
            return context.load_device(path)
        # A camera that is starting, or is used by another program, may be listed but not answer.
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
        """The next image with both colour and depth; None if none came in time."""
        deadline = time.monotonic() + timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            there, frames = self._syncer.try_wait_for_frames(max(int(left_s * 1000), 1))
            arrived_ns = now_ns()
            if not there:
                break
            frameset = frames.as_frameset()
            # While one of the sensors starts, or when USB lost an image, a set has only the other image.
            if frameset.get_depth_frame() and frameset.get_color_frame():
                return self._shot(frameset, arrived_ns)
        if self._recorded and self._device.as_playback().current_status() == self._rs.playback_status.stopped:
            raise CameraError("the recording has ended; it is played again.")
        return None

    def _shot(self, frameset: Any, arrived_ns: int) -> Shot:
        color, depth = frameset.get_color_frame(), frameset.get_depth_frame()
        # Timestamps of two different clocks cannot be compared.
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
        """Stop and close the sensors that were opened."""
        for sensor in self._open:
            with suppress(RuntimeError):  # unplugged
                sensor.stop()
            with suppress(RuntimeError):
                sensor.close()
        self._open.clear()


def chosen_profiles(
    rs: Any, sensors: Sequence[Any], settings: CameraConfig, *, any_rate: bool
) -> list[tuple[Any, list[Any]]]:
    """The depth and the colour stream of the configured size and rate, by sensor (some have both).

    Raises CameraError with what the camera offers instead."""
    device, rate = settings.device, float(settings.rate)
    size = (device.width, device.height)
    wanted = {
        rs.stream.depth: (rs.format.z16, (device.depth_width or size[0], device.depth_height or size[1])),
        rs.stream.color: (rs.format.rgb8, size),
    }
    chosen: dict[Any, tuple[Any, Any]] = {}
    offered: dict[Any, set[tuple[int, int, int]]] = {stream: set() for stream in wanted}
    for place, sensor in enumerate(sensors):
        for profile in sensor.get_stream_profiles():
            stream = profile.stream_type()
            if stream not in wanted or profile.format() != wanted[stream][0]:
                continue
            video = profile.as_video_stream_profile()
            offered[stream].add((video.width(), video.height(), profile.fps()))
            right_rate = any_rate or profile.fps() == rate
            if (video.width(), video.height()) == wanted[stream][1] and right_rate:
                chosen.setdefault(stream, (place, profile))
    for stream, (_, (width, height)) in wanted.items():
        if stream not in chosen:
            name = "depth" if stream == rs.stream.depth else "colour"
            raise CameraError(
                f"no {name} of {width} x {height} at {rate:g} Hz; it offers {_listed(offered[stream])}. "
                "Set camera.device.width and height, depth_width and depth_height, and camera.rate; on USB 2 "
                "a camera offers little: use a USB 3 cable and port."
            )
    return [
        (sensors[place], [profile for at, profile in chosen.values() if at == place])
        for place in sorted({place for place, _ in chosen.values()})
    ]


def _listed(offers: set[tuple[int, int, int]]) -> str:
    return (
        ", ".join(f"{w} x {h} at {fps}" for w, h, fps in sorted(offers, reverse=True)[:12]) or "none at all"
    )


def apply_options(rs: Any, sensors: Sequence[Any], options: Mapping[str, float]) -> None:
    """Set `depth.NAME` or `color.NAME` on the sensor that gives that stream.

    Raises CameraError for an option that it does not have, or a value outside its range."""
    for key, value in options.items():
        kind, _, name = key.partition(".")
        stream = {"depth": rs.stream.depth, "color": rs.stream.color}.get(kind)
        of_stream = [s for s in sensors if any(p.stream_type() == stream for p in s.get_stream_profiles())]
        option = getattr(rs.option, name, None)
        able = [s for s in of_stream if option is not None and s.supports(option)]
        if not able:
            names = sorted({f"{kind}.{o.name}" for s in of_stream for o in s.get_supported_options()})
            raise CameraError(
                f"no option {key}; it has {', '.join(names) or 'depth.NAME and color.NAME'}. "
                "Correct camera.device.options."
            )
        _set(able[0], option, value, f"option {key} = {value:g}", "options")


def made_filters(rs: Any, filters: Mapping[Filter, Mapping[str, float]]) -> list[Any]:
    """The SDK's depth filters with their options, in the order that Intel recommends. Smoothing in space
    and time works on disparity, whose noise does not depend on distance.

    Raises CameraError for an option that a filter does not have, or a value outside its range."""
    made = {}
    for name, options in filters.items():
        made[name] = getattr(rs, f"{name}_filter")()
        for key, value in options.items():
            _set_of_filter(rs, made[name], name, key, value)
    smoothing = [made[name] for name in ("spatial", "temporal") if name in made]
    if smoothing:
        smoothing = [rs.disparity_transform(True), *smoothing, rs.disparity_transform(False)]
    return [
        *(made[name] for name in ("decimation", "threshold") if name in made),
        *smoothing,
        *(made[name] for name in ("hole_filling",) if name in made),
    ]


def _set_of_filter(rs: Any, made: Any, name: str, key: str, value: float) -> None:
    option = getattr(rs.option, key, None)
    if option not in made.get_supported_options():
        names = sorted(
            o.name for o in made.get_supported_options() if not o.name.startswith(("stream", "frames"))
        )
        raise CameraError(
            f"no option {key} of the filter {name}; it has {', '.join(names)}. Correct camera.device.filters."
        )
    _set(made, option, value, f"{key} = {value:g} of the filter {name}", "filters")


def _set(able: Any, option: Any, value: float, what: str, where: str) -> None:
    """Set an option of a sensor or a filter. Raises CameraError for a value outside its range."""
    allowed = able.get_option_range(option)
    if not allowed.min <= value <= allowed.max:
        raise CameraError(
            f"{what} is outside {allowed.min:g} to {allowed.max:g}. Correct camera.device.{where}."
        )
    able.set_option(option, float(value))


def use_own_clock(rs: Any, sensors: Iterable[Any]) -> None:
    """Get timestamps of the device's own clock: the SDK would convert them to the wall clock, which may be
    set."""
    for sensor in sensors:
        with suppress(RuntimeError):
            if sensor.supports(rs.option.global_time_enabled):
                sensor.set_option(rs.option.global_time_enabled, 0.0)


class Rectification(Rectifier):
    """Rectifies the camera's distorted image to that of a pinhole camera with the same intrinsics.

    The SDK itself projects each ray, so every distortion model that it knows works here."""

    def __init__(self, rs: Any, intrinsics: Any) -> None:
        i = intrinsics
        self.camera = Camera(i.fx, i.fy, i.ppx, i.ppy, i.width, i.height)
        maps = None
        if i.model != rs.distortion.none and any(i.coeffs):
            rows, columns = np.mgrid[0 : i.height, 0 : i.width]
            rays = self.camera.rays(np.stack([columns, rows], -1)).reshape(-1, 3).tolist()
            pixels = [rs.rs2_project_point_to_pixel(i, ray) for ray in rays]
            both = np.array(pixels, np.float32).reshape(i.height, i.width, 2)
            maps = (np.ascontiguousarray(both[..., 0]), np.ascontiguousarray(both[..., 1]))
        super().__init__(maps)
