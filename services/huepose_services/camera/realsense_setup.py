"""How a RealSense is set before it starts: streams, options, clock; and how its pictures are rectified."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from huepose.datasets.rectify import Rectifier
from huepose.geometry import Camera
from huepose_services.camera.live import CameraError
from huepose_services.runtime.config_perception import CameraConfig, Filter


def chosen_profiles(
    rs: Any, sensors: Iterable[Any], settings: CameraConfig, *, any_rate: bool
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
    sensors = list(sensors)
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


def apply_options(rs: Any, sensors: Iterable[Any], options: Mapping[str, float]) -> None:
    """Set `depth.NAME` or `color.NAME` on the sensor that gives that stream.

    Raises CameraError for an option that it does not have, or a value outside its range."""
    sensors = list(sensors)
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
    """The SDK's filters of depth with their options, in the order that Intel recommends: smoothing over
    picture and time works on disparity, whose noise is the same near and far.

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
    """An option of a sensor or a filter. Raises CameraError for a value outside its range."""
    allowed = able.get_option_range(option)
    if not allowed.min <= value <= allowed.max:
        raise CameraError(
            f"{what} is outside {allowed.min:g} to {allowed.max:g}. Correct camera.device.{where}."
        )
    able.set_option(option, float(value))


def use_own_clock(rs: Any, sensors: Iterable[Any]) -> None:
    """Have stamps in the device's own time: the SDK's mapping goes to the wall clock, which may be set."""
    for sensor in sensors:
        with suppress(RuntimeError):
            if sensor.supports(rs.option.global_time_enabled):
                sensor.set_option(rs.option.global_time_enabled, 0.0)


class Rectification(Rectifier):
    """From the camera's distorted picture to a pinhole's with the same intrinsics.

    The SDK projects each ray itself, so every distortion model that it knows holds here too."""

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
