"""The part of an OAK's pipeline that runs on the device, for both of its generations."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import timedelta
from typing import Any

from huepose.support.errors import InputError
from huepose_services.runtime.config_perception import CameraConfig

# Each is a switch of stereo matching, on for values other than 0.
STEREO_OPTIONS = {
    "depth.left_right_check": "setLeftRightCheck",
    "depth.subpixel": "setSubpixel",
    "depth.extended_disparity": "setExtendedDisparity",
}
COLOR_OPTIONS = ("color.exposure_us", "color.iso")
DEFAULTS = {"depth.left_right_check": 1.0, "depth.subpixel": 1.0}


def check_options(options: Mapping[str, float]) -> None:
    """Raises InputError for an option that is not known, or half of a manual exposure."""
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
