"""The sections of pipeline.yaml about cameras and networks, and what their keys must have in common."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from huepose_protos.fields import Name
from huepose_protos.parts import Mount

Rate = Annotated[float, Meta(gt=0.0, le=240.0)]
Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Side = Annotated[float, Meta(ge=0.0, le=16384.0)]
Pixels = Annotated[int, Meta(ge=16, le=8192)]
Share = Annotated[float, Meta(gt=0.0, lt=1.0)]
Provider = Literal["tensorrt", "cuda", "openvino", "cpu"]
Layout = Literal["auto", "v5", "v8", "yolox", "yolox_raw", "end2end"]
Class = Annotated[int, Meta(ge=0, le=100_000)] | str
Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
Refuse = Callable[[str, str, str, str], None]

DRAWN_SOURCES = ("synthetic", "faulty")
LIVE_SOURCES = ("realsense", "oak", "python", "faulty")
Filter = Literal["decimation", "threshold", "spatial", "temporal", "hole_filling"]


class Section(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part of pipeline.yaml: no other keys than these."""


class DeviceConfig(Section, frozen=True, kw_only=True):
    """A live camera: which one, and how it is set."""

    serial: str | None = None
    width: Pixels = 640
    height: Pixels = 480
    depth_width: Pixels | None = None
    depth_height: Pixels | None = None
    align: bool = True
    options: dict[str, float] = {}
    filters: dict[Filter, dict[str, float]] = {}


class CameraConfig(Section, frozen=True, kw_only=True):
    """Where frames come from, and when."""

    name: Name = "cam0"
    source: Literal["synthetic", "bop", "fast_ycb", "recording", "realsense", "oak", "python", "faulty"] = (
        "synthetic"
    )
    path: str | None = None
    seed: Annotated[int, Meta(ge=0)] = 0
    rate: Rate | Literal["recorded"] = 30.0
    once: bool = False
    first_frame_s: Seconds = 5.0
    truth: bool = False
    depth_scale_m: Annotated[float, Meta(gt=0.0, le=0.01)] = 0.0001
    device: DeviceConfig = DeviceConfig()
    mount: Mount | None = None
    moving: bool = False


class DetectorConfig(Section, frozen=True, kw_only=True):
    """How boxes are found."""

    kind: Literal["colorpair", "truth", "first_box", "yolo"] = "colorpair"
    boxes: dict[Name, tuple[Side, Side, Side, Side]] = {}
    seed: Annotated[int, Meta(ge=0)] = 0
    model: str | None = None
    layout: Layout = "auto"
    classes: dict[Name, Class | list[Class]] = {}
    confidence: Share = 0.25
    overlap: Share = 0.45
    threads: Annotated[int, Meta(ge=1, le=64)] = 2


class SegmenterConfig(Section, frozen=True, kw_only=True):
    """How objects are outlined in their boxes."""

    kind: Literal["depth", "sam"] = "depth"
    encoder: str | None = None
    decoder: str | None = None


class NetworksConfig(Section, frozen=True, kw_only=True):
    """How the networks of detector and segmenter are run."""

    providers: Annotated[tuple[Provider, ...], Meta(min_length=1)] = ("tensorrt", "cuda", "openvino", "cpu")
    threads: Annotated[int, Meta(ge=1, le=64)] = 1
    fp16: bool = True
    cache: str | None = None
    sha256: dict[str, Sha256] = {}


def absolute_path(text: str, folder: Path) -> str:
    """A path that holds anywhere. Raises ValueError or RuntimeError for what can be none."""
    if "\0" in text:
        raise ValueError("a character that no path has")
    return str(folder / Path(text).expanduser())


def absolute_network(text: str | None, folder: Path) -> str | None:
    """A network by path, relative to `folder`; a name that `huepose models` knows stays as it is."""
    if text is None or not (text.endswith(".onnx") or "/" in text):
        return text
    return absolute_path(text, folder)


def absolute_networks(
    detector: DetectorConfig, segmenter: SegmenterConfig, networks: NetworksConfig, folder: Path
) -> dict[str, Section]:
    """The three sections with paths that hold anywhere."""
    cache = networks.cache and absolute_path(networks.cache, folder)
    return {
        "detector": msgspec.structs.replace(detector, model=absolute_network(detector.model, folder)),
        "segmenter": msgspec.structs.replace(
            segmenter,
            encoder=absolute_network(segmenter.encoder, folder),
            decoder=absolute_network(segmenter.decoder, folder),
        ),
        "networks": msgspec.structs.replace(networks, cache=cache),
    }


def check_camera(camera: CameraConfig, refuse: Refuse) -> None:
    """Raises by `refuse` what the keys of the camera's section cannot be together."""
    source, live = camera.source, camera.source in LIVE_SOURCES
    if source in ("synthetic", "oak") and camera.path is not None:
        refuse("camera.path", camera.path, f"no path with the source {source}", "Set it to null.")
    if source in ("bop", "fast_ycb") and camera.path is None:
        refuse("camera.path", "null", "the folder of the recording", "Set it to the scene's folder.")
    if source == "python" and camera.path is None:
        refuse("camera.path", "null", "a Python file with a function frames()", "docs/cameras.md has one.")
    if source == "recording" and camera.path is None:
        refuse("camera.path", "null", "a file of `huepose record`", "Set it to the .mcap file.")
    if source == "faulty" and camera.path is None:
        refuse("camera.path", "null", "the file of the orders", "`huepose chaos` sets it.")
    if (live or source == "synthetic") and camera.rate == "recorded":
        refuse("camera.rate", "recorded", f"frames per second with the source {source}", "Set it to 30.")
    if live and (camera.once or (camera.truth and source != "faulty")):
        key = "once" if camera.once else "truth"
        refuse(f"camera.{key}", "true", f"false with the source {source}", "Take the line out.")
    if not live and camera.device != DeviceConfig():
        refuse("camera.device", "settings", f"none with the source {source}", "Take the section out.")
    if source != "realsense" and camera.device.filters:
        refuse("camera.device.filters", "some", f"none with the source {source}", "Take the line out.")
    if (camera.device.depth_width is None) != (camera.device.depth_height is None):
        refuse("camera.device.depth_width", "one side", "depth_width and depth_height", "Set both or none.")


def check_detector(
    detector: DetectorConfig, runs: bool, truth: bool, names: Collection[str], refuse: Refuse
) -> None:
    """The same for the detector; `runs`: whether it is among the workers, `names`: the objects by name."""
    if detector.kind == "truth" and runs and not truth:
        refuse("detector.kind", "truth", "camera.truth: true beside it", "Set camera.truth to true.")
    if detector.kind == "first_box" and not detector.boxes and runs:
        refuse("detector.boxes", "none", "a box [x, y, w, h] by object", "Give each object's first box.")
    for name, box in detector.boxes.items():
        if name not in names:
            refuse("detector.boxes", name, f"one of objects: {', '.join(names)}", "Correct the name.")
        if box[2] < 1 or box[3] < 1:
            refuse(f"detector.boxes.{name}", f"{list(box)}", "[x, y, w, h] with w, h >= 1", "Correct it.")
    if detector.kind != "yolo":
        return
    if detector.model is None:
        refuse("detector.model", "null", "an ONNX file, or a name", "`huepose models list` shows the names.")
    for name in detector.classes:
        if names and name not in names:
            refuse("detector.classes", name, f"one of objects: {', '.join(names)}", "Correct the name.")


def check_segmenter(segmenter: SegmenterConfig, refuse: Refuse) -> None:
    """The same for the segmenter: its two networks are named both, or neither."""
    if (segmenter.encoder is None) != (segmenter.decoder is None):
        key = "encoder" if segmenter.encoder is None else "decoder"
        fix = "`huepose models list` shows the names."
        refuse(f"segmenter.{key}", "null", "an ONNX file, or a name, as for the other", fix)
