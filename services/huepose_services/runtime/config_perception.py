"""The sections of pipeline.yaml about cameras and networks, and checks of their keys against each other."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Literal, TypeVar, get_args, get_type_hints

import msgspec
from msgspec import Meta, Struct

from huepose_protos.fields import Name, Quaternion
from huepose_protos.messages import FrameHeader
from huepose_protos.parts import Mount

Rate = Annotated[float, Meta(gt=0.0, le=240.0)]
Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Pixels = Annotated[int, Meta(ge=16, le=8192)]
Share = Annotated[float, Meta(gt=0.0, lt=1.0)]
Provider = Literal["tensorrt", "cuda", "openvino", "cpu"]
Layout = Literal["auto", "v5", "v8", "yolox", "yolox_raw", "end2end"]
Class = Annotated[int, Meta(ge=0, le=100_000)] | str
Sha256 = Annotated[str, Meta(pattern="^[0-9a-f]{64}$", description="64 digits 0-9 a-f")]
Refuse = Callable[[str, str, str, str], None]

Recorded = Literal["bop", "fast_ycb", "recording", "rosbag"]
Live = Literal["realsense", "oak", "python", "faulty"]
DRAWN_SOURCES = ("synthetic", "faulty")
LIVE_SOURCES: tuple[Live, ...] = get_args(Live)
Filter = Literal["decimation", "threshold", "spatial", "temporal", "hole_filling"]


class Section(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part of pipeline.yaml: no other keys than these."""


S = TypeVar("S", bound=Section)


class DeviceConfig(Section, frozen=True, kw_only=True):
    """A live camera: which one, and its settings."""

    serial: str | None = None
    width: Pixels = 640
    height: Pixels = 480
    depth_width: Pixels | None = None
    depth_height: Pixels | None = None
    align: bool = True
    options: dict[str, float] = {}
    filters: dict[Filter, dict[str, float]] = {}


FRAME_NAME_IN_WORDS = "1 to 64 characters, no blank among them, no / first"
_FRAME_NAME = r"^[^/\s]\S{0,63}\Z"
FrameName = Annotated[str, Meta(pattern=_FRAME_NAME, description=FRAME_NAME_IN_WORDS)]


def is_frame_name(text: str) -> bool:
    """Whether a coordinate frame may have this name."""
    return re.fullmatch(_FRAME_NAME, text) is not None


class FixedMount(Mount, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The camera's extrinsics: its pose in the frame `parent`. All three keys are needed."""

    parent: FrameName
    quaternion: Quaternion


class TfConfig(Section, frozen=True, kw_only=True):
    """A transform of ROS 2, from /tf and /tf_static: the pose of the frame `child` in the frame `parent`."""

    parent: FrameName
    child: FrameName


class CameraConfig(Section, frozen=True, kw_only=True):
    """Where frames come from, and when. check: whether images are checked for faults of the camera's
    settings."""

    name: Name = "cam0"
    source: Literal["synthetic"] | Recorded | Live = "synthetic"
    path: str | None = None
    color_topic: str | None = None
    depth_topic: str | None = None
    info_topic: str | None = None
    seed: Annotated[int, Meta(ge=0)] = 0
    rate: Rate | Literal["recorded"] = 30.0
    once: bool = False
    first_frame_s: Seconds = 5.0
    truth: bool = False
    depth_scale_m: Annotated[float, Meta(gt=0.0, le=0.01)] = 0.0001
    check: bool = True
    device: DeviceConfig = DeviceConfig()
    mount: FixedMount | None = None
    moving: bool = False
    tf: TfConfig | None = None

    @property
    def frame(self) -> str:
        """The name of the coordinate frame that poses are in."""
        return f"{self.name}_color_optical"

    @property
    def told(self) -> bool:
        """Whether the camera's pose is given again and again, because it moves: by a program or by /tf."""
        return self.moving or self.tf is not None


class DetectorConfig(Section, frozen=True, kw_only=True):
    """How boxes are found."""

    kind: Literal["views", "yolo"] = "views"
    model: str | None = None
    layout: Layout = "auto"
    classes: dict[Name, Class | list[Class]] = {}
    confidence: Share = 0.25
    overlap: Share = 0.45
    threads: Annotated[int, Meta(ge=1, le=64)] = 2


class SegmenterConfig(Section, frozen=True, kw_only=True):
    """How objects are segmented in their boxes."""

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


TLS_FILES = ("authority", "certificate", "key", "revoked")
PATHS = frozenset(
    {"bundles", "link.secure", "camera.path", "networks.cache"}
    | {f"gateway.tls.{name}" for name in TLS_FILES}
)
"""The keys that are paths, relative to the folder of the file."""
NETWORKS = frozenset({"detector.model", "segmenter.encoder", "segmenter.decoder"})
"""The keys that are a path, or a name of `huepose models`."""


def is_network_file(text: str) -> bool:
    """Whether a network is named by its path."""
    return text.endswith(".onnx") or "/" in text


def absolute(section: S, folder: Path, name: str = "") -> S:
    """A section, or the whole configuration, with absolute paths. Raises ValueError or RuntimeError for a
    text that cannot be a path."""
    changes: dict[str, object] = {}
    for field in section.__struct_fields__:
        key, value = f"{name}{field}", getattr(section, field)
        if isinstance(value, Section):
            changes[field] = absolute(value, folder, f"{key}.")
        elif value is not None and (key in PATHS or (key in NETWORKS and is_network_file(value))):
            if "\0" in value:
                raise ValueError("a character that no path has")
            path = folder / Path(value).expanduser()
            changes[field] = str(path.resolve() if ".." in path.parts else path)
    return msgspec.structs.replace(section, **changes)


_PATH_IS = {
    **dict.fromkeys(("bop", "fast_ycb"), ("the folder of the recording", "Set it to the scene's folder.")),
    "python": ("a Python file with a function frames()", "docs/cameras.md has one."),
    "recording": ("a file of `huepose record`", "Set it to the .mcap file."),
    "rosbag": ("a .bag file, or the folder of a bag of ROS 2", "Set it to the bag."),
    "faulty": ("the file of the orders", "`huepose chaos` sets it."),
}


_LONGEST_FRAME: int = get_args(get_type_hints(FrameHeader, include_extras=True)["frame"])[1].max_length
"""The largest length of a coordinate frame's name in messages."""


def check_camera(camera: CameraConfig, workers: Collection[str], refuse: Refuse) -> None:
    """Calls `refuse` for keys of the camera's section that contradict each other, or the workers."""
    source, live = camera.source, camera.source in LIVE_SOURCES
    if (over := len(camera.frame) - _LONGEST_FRAME) > 0:
        most = len(camera.name) - over
        refuse("camera.name", camera.name, f"at most {most} characters", f"Poses are in {camera.frame}.")
    if camera.tf is not None:
        _check_tf(camera, camera.tf, workers, refuse)
    if source in ("synthetic", "oak") and camera.path is not None:
        refuse("camera.path", camera.path, f"no path with the source {source}", "Set it to null.")
    if source in _PATH_IS and camera.path is None:
        refuse("camera.path", "null", *_PATH_IS[source])
    if (live or source == "synthetic") and camera.rate == "recorded":
        refuse("camera.rate", "recorded", f"frames per second with the source {source}", "Set it to 30.")
    for key, allowed in (("once", "python"), ("truth", "faulty")):
        if live and getattr(camera, key) and source != allowed:
            refuse(f"camera.{key}", "true", f"false with the source {source}", "Take the line out.")
    if source == "rosbag" and camera.truth:
        refuse("camera.truth", "true", "false: a bag has no labels", "Take the line out.")
    for key in ("color_topic", "depth_topic", "info_topic"):
        if source != "rosbag" and (topic := getattr(camera, key)) is not None:
            refuse(f"camera.{key}", topic, f"none with the source {source}", "Take the line out.")
    if not live and camera.device != DeviceConfig():
        refuse("camera.device", "settings", f"none with the source {source}", "Take the section out.")
    if source != "realsense" and camera.device.filters:
        refuse("camera.device.filters", "some", f"none with the source {source}", "Take the line out.")
    if (camera.device.depth_width is None) != (camera.device.depth_height is None):
        refuse("camera.device.depth_width", "one side", "depth_width and depth_height", "Set both or none.")


def _check_tf(camera: CameraConfig, tf: TfConfig, workers: Collection[str], refuse: Refuse) -> None:
    names = f"{{parent: {tf.parent}, child: {tf.child}}}"
    if "ros2" not in workers:
        refuse(
            "camera.tf", names, "the worker ros2 beside it, which listens to /tf", "Add ros2 to `workers`."
        )
    if tf.parent == tf.child:
        refuse("camera.tf", names, "two frames", "parent: the robot's base; child: what holds the camera.")
    if camera.mount is not None and camera.mount.parent != tf.child:
        fix = "`mount` is the camera's pose in the frame `tf.child`; leave it out if that is the camera."
        refuse("camera.mount.parent", camera.mount.parent, f"{tf.child}, as camera.tf.child", fix)
    if camera.mount is not None and tf.child == camera.frame:
        refuse("camera.mount", "one", f"none beside the camera's own frame, {tf.child}", "Take it out.")


def check_detector(detector: DetectorConfig, names: Collection[str], refuse: Refuse) -> None:
    """The same for the detector; `names`: the objects by name."""
    if detector.kind != "yolo":
        return
    if detector.model is None:
        refuse("detector.model", "null", "an ONNX file, or a name", "`huepose models list` shows the names.")
    for name in detector.classes:
        if names and name not in names:
            refuse("detector.classes", name, f"one of objects: {', '.join(names)}", "Correct the name.")


def check_segmenter(segmenter: SegmenterConfig, refuse: Refuse) -> None:
    """The same for the segmenter: both of its networks are named, or neither."""
    if (segmenter.encoder is None) != (segmenter.decoder is None):
        key = "encoder" if segmenter.encoder is None else "decoder"
        fix = "`huepose models list` shows the names."
        refuse(f"segmenter.{key}", "null", "an ONNX file, or a name, as for the other", fix)
