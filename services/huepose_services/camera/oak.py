"""OAK cameras through depthai v3: colour, and stereo depth in the pixels of colour, both undistorted on the
device.

The part on the device (`build`) and the part on the host (`OakCamera`: reads a queue of synchronised
groups) are separate, so that the second runs with any nodes that give such groups. depthai itself converts
timestamps to CLOCK_MONOTONIC and follows the device's drift.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from datetime import timedelta
from typing import Any

import numpy as np

from huepose.geometry import Camera
from huepose.geometry.arrays import Float32
from huepose.support.errors import InputError
from huepose_services.camera.live import REPLUG, CameraError, LiveSource, Shot, sdk, the_one
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig

# Each switches an option of stereo matching on, for values other than 0.
STEREO_OPTIONS = {
    "depth.left_right_check": "setLeftRightCheck",
    "depth.subpixel": "setSubpixel",
    "depth.extended_disparity": "setExtendedDisparity",
}
COLOR_OPTIONS = ("color.exposure_us", "color.iso")
DEFAULTS = {"depth.left_right_check": 1.0, "depth.subpixel": 1.0}


def check_options(options: Mapping[str, float]) -> None:
    """Raises InputError for an option that is not known, or for exposure time or ISO without the other."""
    known = (*STEREO_OPTIONS, *COLOR_OPTIONS)
    for key in options:
        if key not in known:
            raise InputError("camera.device.options", found=f"'{key}'", expected=f"one of {', '.join(known)}")
    given = [key for key in COLOR_OPTIONS if key in options]
    if len(given) == 1:
        raise InputError("camera.device.options", found=given[0], expected=f"{' and '.join(COLOR_OPTIONS)}")


def build(dai: Any, device: Any, settings: CameraConfig) -> tuple[Any, Any]:
    """A pipeline on the device, and the queue of its groups of `color` and `depth`."""
    wanted, options = settings.device, {**DEFAULTS, **settings.device.options}
    fps = float(settings.rate)
    size = (wanted.width, wanted.height)
    pipeline = dai.Pipeline(device)
    camera = pipeline.create(dai.node.Camera).build(dai.CameraBoardSocket.CAM_A, sensorFps=fps)
    if COLOR_OPTIONS[0] in options:
        camera.initialControl.setManualExposure(*(int(options[key]) for key in COLOR_OPTIONS))
    color = camera.requestOutput(size, dai.ImgFrame.Type.BGR888i, fps=fps, enableUndistortion=True)
    stereo_size = (wanted.depth_width or 640, wanted.depth_height or 400)
    left, right = (
        pipeline.create(dai.node.Camera).build(socket, sensorFps=fps).requestOutput(stereo_size, fps=fps)
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C)
    )
    stereo = pipeline.create(dai.node.StereoDepth).build(
        left, right, presetMode=dai.node.StereoDepth.PresetMode.DEFAULT
    )
    for key, setter in STEREO_OPTIONS.items():
        if key in options:
            getattr(stereo, setter)(bool(options[key]))
    # The second generation aligns inside stereo matching, the fourth in a node of its own.
    if device.getPlatform() == dai.Platform.RVC2:
        stereo.setOutputSize(*size)
        color.link(stereo.inputAlignTo)
        depth = stereo.depth
    else:
        align = pipeline.create(dai.node.ImageAlign)
        stereo.depth.link(align.input)
        color.link(align.inputAlignTo)
        depth = align.outputAligned
    return pipeline, synchronised(dai, pipeline, color, depth, fps, on_host=False)


def synchronised(dai: Any, pipeline: Any, color: Any, depth: Any, fps: float, *, on_host: bool) -> Any:
    """A queue that holds the newest group of two outputs captured within half a period of each other."""
    sync = pipeline.create(dai.node.Sync)
    sync.setRunOnHost(on_host)
    sync.setSyncThreshold(timedelta(seconds=0.5 / fps))
    color.link(sync.inputs["color"])
    depth.link(sync.inputs["depth"])
    return sync.out.createOutputQueue(maxSize=1, blocking=False)


def open_source(config: Config) -> LiveSource:
    """The camera of the configuration, not opened. Raises InputError without the SDK."""
    # The search for a missing camera takes 11 s by default. The SDK reads this variable when it is
    # imported.
    os.environ.setdefault("DEPTHAI_SEARCH_TIMEOUT", "0")
    depthai = sdk("depthai", "oak", "Luxonis' SDK for Python")
    check_options(config.camera.device.options)
    return source_of(depthai, config.camera)


def source_of(dai: Any, settings: CameraConfig) -> LiveSource:
    """One camera, by its device id, or the only one."""
    serial = settings.device.serial

    def start() -> OakCamera:
        infos = {info.getDeviceId(): info for info in dai.Device.getAllAvailableDevices()}
        info = the_one(infos, serial, _NONE)
        try:
            device = dai.Device(info)
        except RuntimeError as error:
            raise CameraError(f"it does not start: {error}. Is another program using it?") from None
        try:
            pipeline, queue = build(dai, device, settings)
            pipeline.start()
        except RuntimeError as error:
            device.close()
            raise CameraError(f"it cannot do what is configured: {error}. See camera.device.") from None
        return OakCamera(pipeline, queue, device)

    return LiveSource(f"OAK {serial}" if serial else "OAK", REPLUG, start)


_NONE = (
    "no OAK camera is connected. Plug it into a USB 3 port (or its network); if `lsusb -d 03e7:` lists it, "
    "install the udev rules (deploy/jetson/install.sh --udev) and plug it in again."
)


class OakCamera:
    """A running pipeline whose queue gives groups of `color` and `depth`."""

    device_clock_is_host = True
    is_sensor = True

    def __init__(self, pipeline: Any, queue: Any, device: Any = None) -> None:
        self._pipeline, self._queue, self._device = pipeline, queue, device

    def read(self, timeout_s: float) -> Shot | None:
        """The next image; None if none came in time. Raises CameraError if the camera is gone."""
        # `get` with a timeout raises the same error for an ended pipeline, so the state is asked first.
        if not self._pipeline.isRunning() or (self._device is not None and self._device.isClosed()):
            raise CameraError("the connection is lost. Check the cable; the search for the camera goes on.")
        group = self._queue.get(timedelta(seconds=max(timeout_s, 0.001)))
        return None if group is None else shot_of(group["color"], group["depth"], now_ns())

    def close(self) -> None:
        """Stop the pipeline and close the device."""
        with suppress(RuntimeError):
            self._pipeline.stop()
        if self._device is not None:
            with suppress(RuntimeError):
                self._device.close()


def shot_of(color: Any, depth: Any, arrived_ns: int) -> Shot:
    """A Shot from two depthai images of the same size: BGR, and depth in millimetres.

    Raises CameraError if the sizes differ, or the colour image has no intrinsics."""
    height, width = color.getHeight(), color.getWidth()
    if (depth.getHeight(), depth.getWidth()) != (height, width):
        raise CameraError(f"depth is {depth.getWidth()} x {depth.getHeight()}, colour {width} x {height}.")
    K = np.array(color.getTransformation().getIntrinsicMatrix(), dtype=np.float64)
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise CameraError("it has no calibration: write one with Luxonis' calibration tool.")
    metres: Float32 = depth.getFrame().astype(np.float32) * np.float32(0.001)
    stamps = [round(one.getTimestamp() / timedelta(microseconds=1)) * 1000 for one in (color, depth)]
    return Shot(
        color=np.ascontiguousarray(color.getCvFrame()[..., ::-1]),
        depth=metres,
        camera=Camera.from_matrix(K, width, height),
        number=color.getSequenceNum(),
        device_ns=stamps[0],
        depth_ns=stamps[1],
        arrived_ns=arrived_ns,
    )
