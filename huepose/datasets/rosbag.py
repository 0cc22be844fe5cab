"""A ROS bag as a scene: `.bag` of ROS 1, or the folder of a ROS 2 bag (sqlite3, mcap), read by rosbags.

Colour and depth are paired by the timestamps in their headers: each colour image gets the nearest depth
image, at most half the usual time between two colour images away. Depth must be aligned to colour.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from huepose.datasets.files import instead_of_film
from huepose.datasets.ros_images import camera_of, color_of, depth_of, encoding_of, field, kind_of
from huepose.datasets.types import GroundTruth
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_INFO = "sensor_msgs/msg/CameraInfo"
_USUAL_NS = 1_000_000_000 // 30
"""Time between images at 30 Hz: used if a recording has only one colour image."""

_TRANSPORTS = ("/compressed", "/compressedDepth")
_ALIGNED = (
    "Record depth that is aligned to colour: with realsense2_camera align_depth.enable:=true and its topic "
    "aligned_depth_to_color, with others depth_registered or depth_to_rgb."
)


_UNALIGNED, _SAME_SENSOR = "/depth/image_rect_raw", "/image_rect_raw"
"""Topics of realsense2_camera: depth that is not aligned to colour, and colour of a D405, which has the same
pixels as its depth."""


@dataclass(frozen=True)
class Topics:
    """The topics to read; None: the only one that fits."""

    color: str | None = None
    depth: str | None = None
    info: str | None = None


class RosbagScene:
    """The rectified frames of a bag, numbered from 0. topics: None if the user cannot choose them; then
    errors do not propose it. Raises InputError for a bag that is broken, has no pair of colour and depth,
    or whose camera changes."""

    def __init__(self, path: Path, topics: Topics | None = None) -> None:
        self.name, self._path = path.stem, path
        chosen = _Choice(path, _firsts(path), topics)
        self.topics = Topics(chosen.color, chosen.depth, chosen.info)
        self._camera, self._rectifier = chosen.camera
        _check_one_camera(path, chosen.info)
        self._color, self._depth = _Stream(path, chosen.color), _Stream(path, chosen.depth)
        self._pairs = _paired(self._color.places, self._depth.places)
        if not self._pairs:
            raise InputError(
                path,
                found=f"no depth of {chosen.depth} at the time of an image of {chosen.color}",
                expected="timestamps of one clock, at most half a frame apart",
            )
        self.image_ids = tuple(range(len(self._pairs)))

    def stamp_ns(self, image: int) -> int:
        """The timestamp of the colour image."""
        return self._pairs[image][0].stamp_ns

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth. Raises InputError if they are broken, or differ in size from the first images."""
        color, depth = (
            stream.at(place)
            for stream, place in zip((self._color, self._depth), self._pairs[image], strict=True)
        )
        return RgbdFrame(
            self._rectifier.color(color_of(color, f"{self._path}, {self._color.topic}")),
            self._rectifier.depth(depth_of(depth, f"{self._path}, {self._depth.topic}")),
            self._camera,
            stamp_ns=self.stamp_ns(image),
        )

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """None: a bag has no labels."""
        return ()


@dataclass(frozen=True, order=True)
class _Place:
    """Identifies a message: the timestamp in its header, and the time at which it was recorded."""

    stamp_ns: int
    log_ns: int


def _paired(colors: list[_Place], depths: list[_Place]) -> list[tuple[_Place, _Place]]:
    """Each colour image with its depth image, in order of time; colour images without one are left out, and
    repetitions, which have the timestamp of another."""
    colors, depths = sorted({color.stamp_ns: color for color in colors}.values()), sorted(depths)
    gaps = sorted(b.stamp_ns - a.stamp_ns for a, b in pairwise(colors))
    reach_ns = (gaps[len(gaps) // 2] if gaps else _USUAL_NS) // 2
    stamps = [depth.stamp_ns for depth in depths]
    pairs = []
    for color in colors:
        after = bisect_left(stamps, color.stamp_ns)
        near = min(depths[max(after - 1, 0) : after + 1], key=lambda d: abs(d.stamp_ns - color.stamp_ns))
        if abs(near.stamp_ns - color.stamp_ns) <= reach_ns:
            pairs.append((color, near))
    return pairs


class _Stream:
    """The messages of one topic. Consecutive ones are read without a new search in the file."""

    def __init__(self, path: Path, topic: str) -> None:
        self._path, self.topic = path, topic
        self._left: Iterator[_Message] = iter(())
        self._last: _Place | None = None
        self.places = [message.place for message in _messages(path, topic)]
        if any(place.stamp_ns == 0 for place in self.places):
            raise InputError(f"{path}, {topic}", found="image without a timestamp", expected="header.stamp")

    def at(self, place: _Place) -> Any:
        """The message at this place."""
        if self._last is None or place.log_ns <= self._last.log_ns:
            self._left = _messages(self._path, self.topic, place.log_ns)
        for message in self._left:
            if message.place == place:
                self._last = place
                return message.read()
        raise InputError(self._path, found="another bag than before", expected="a file that does not change")


@dataclass(frozen=True)
class _Message:
    path: Path
    reader: AnyReader
    kind: str
    raw: bytes
    place: _Place

    def read(self) -> Any:
        """The deserialised message."""
        try:
            return self.reader.deserialize(self.raw, self.kind)
        except Exception as error:
            raise _broken(self.path, error) from error


def _messages(path: Path, topic: str, since_ns: int | None = None) -> Iterator[_Message]:
    """The messages of one topic, in the order in which they were recorded. Each iterator has its own reader,
    because some readers support only one iterator at a time; the reader is closed with it."""
    with _opened(path) as reader:
        ours = [one for one in reader.connections if one.topic == topic]
        with closing(reader.messages(ours, start=since_ns)) as messages:
            for one, log_ns, raw in messages:
                yield _Message(path, reader, one.msgtype, raw, _Place(_stamp_ns(raw, reader.is2), log_ns))


_SAME_CAMERA = {"k": 0.5, "d": 1e-3, "p": 0.5}
"""Largest differences within one bag: half a pixel in K and P, 0.001 in the distortion coefficients D."""


def _check_one_camera(path: Path, topic: str) -> None:
    """Raises InputError if the CameraInfo of a topic changes, for example in size, zoom or focus."""
    first, first_ns = None, 0
    for message in _messages(path, topic):
        info = message.read()
        if first is None:
            first, first_ns = info, message.place.log_ns
        if (what := _changed(first, info)) is None:
            continue
        raise InputError(
            f"{path}, {topic}",
            found=f"another {what} {(message.place.log_ns - first_ns) * 1e-9:.2f} s after its first message "
            f"(stamp {message.place.stamp_ns * 1e-9:.3f})",
            expected="one camera in all of the bag",
            fix="Cut the bag there, or record with constant size, zoom and focus.",
        )


def _changed(one: Any, other: Any) -> str | None:
    """What differs between two messages of a camera; None if nothing does."""
    if (one.width, one.height) != (other.width, other.height):
        return f"size ({other.width} x {other.height})"
    differs = (k for k, by in _SAME_CAMERA.items() if not _same(field(one, k), field(other, k), by))
    return next((name.upper() for name in differs), None)


def _stamp_ns(raw: bytes, is2: bool) -> int:
    """The timestamp, without decoding the image. It follows `seq` in ROS 1, and the four bytes of the CDR
    header in ROS 2, the second of which gives the byte order."""
    seconds, nanoseconds = struct.unpack_from(">II" if is2 and not raw[1] & 1 else "<II", raw, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _firsts(path: Path) -> dict[str, Any]:
    """The first message of each topic of images or CameraInfo."""
    found: dict[str, Any] = {}
    with _opened(path) as reader:
        for one in sorted(reader.connections, key=lambda one: one.topic):
            if one.topic in found or one.msgtype not in (*_IMAGES, _INFO):
                continue
            with closing(reader.messages([one])) as messages:
                for _, _, raw in messages:
                    found[one.topic] = reader.deserialize(raw, one.msgtype)
                    break
    return found


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if not path.exists() or (path.is_dir() and not (path / "metadata.yaml").is_file()):
        raise _broken(path, "no metadata.yaml in it" if path.exists() else "no such file")
    try:
        # Bags of older ROS 2 versions have no definitions of their types.
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
        try:
            yield reader
        finally:
            with suppress(Exception):  # it imports modules, which fails while the interpreter shuts down
                reader.close()
    except Exception as error:  # rosbags passes on errors of any type from its parsers
        raise _broken(path, error) from error


def _broken(path: Path, error: Exception | str) -> InputError:
    if "not ros2" in str(error):
        return InputError(
            path,
            found="a file of another program than ROS",
            expected="a ROS bag",
            fix="A recording of `huepose record` is played with `source: recording`.",
        )
    return InputError(
        path,
        found=" ".join(str(error).split())[:200] or type(error).__name__,
        expected="a complete .bag of ROS 1, or the folder of a ROS 2 bag, with its metadata.yaml",
        fix=instead_of_film(path)
        or "`rosbag reindex` or `ros2 bag reindex` repairs a bag whose recording was cut off.",
    )


class _Choice:
    """Chooses the topics of a bag: those named by the user, else the only ones that fit."""

    def __init__(self, path: Path, firsts: Mapping[str, Any], topics: Topics | None) -> None:
        self._path, self._topics, self._can_name = path, topics or Topics(), topics is not None
        self._infos = {topic: m for topic, m in firsts.items() if m.__msgtype__ == _INFO}
        self._first = {topic: m for topic, m in firsts.items() if topic not in self._infos}
        colors = self._candidates("color", self._topics.color)
        depths = self._candidates("depth", self._topics.depth)
        pairs = [(color, depth) for color in colors for depth in depths]
        refusals = {pair: reason for pair in pairs if (reason := self._apart(*pair))}
        fitting = [pair for pair in pairs if pair not in refusals]
        if len(pairs) == 1 and refusals:
            raise InputError(f"{path}, {depths[0]}", found=refusals[pairs[0]], fix=_ALIGNED)
        if len(fitting) != 1:
            raise InputError(
                path,
                found=f"{len(fitting) or 'no'} pairs of colour and depth that fit, in {self._listed()}",
                expected="one",
                fix=self._named_or(
                    "name them: camera.color_topic and camera.depth_topic",
                    f"leave others out: rosbags-convert --include-topic. {'' if fitting else _ALIGNED}",
                ),
            )
        self.color, self.depth = fitting[0]
        self.info = self._info_of(self.color)
        where = f"{path}, {self.info}"
        info = self._infos[self.info]
        height, width = color_of(self._first[self.color], path).shape[:2]
        if (info.width, info.height) != (width, height):
            raise InputError(
                where,
                found=f"a camera of {info.width} x {info.height}{_partly(info)}",
                expected=f"{width} x {height}, as the images of {self.color}",
                fix=self._named_or("name another: camera.info_topic", "record the one of these images."),
            )
        # By convention of image_proc, topics named image_rect* have rectified images.
        self.camera = camera_of(info, _base(self.color).rpartition("/")[2].startswith("image_rect"), where)

    def _candidates(self, kind: str, named: str | None) -> list[str]:
        """The topic that is named, or all topics of a kind, without compressed copies of another topic."""
        read = color_of if kind == "color" else depth_of
        if named is not None:
            if named not in self._first:
                raise InputError(
                    f"camera.{kind}_topic {named}",
                    found="no images of that name",
                    expected=f"a topic of {self._path}: {self._listed()}",
                )
            read(self._first[named], f"{self._path}, {named}")
            return [named]
        found = [topic for topic, message in self._first.items() if kind_of(message) == kind]
        others = [topic for topic, message in self._first.items() if kind_of(message) is None]
        if not found and len(others) == 1:
            read(self._first[others[0]], f"{self._path}, {others[0]}")  # raises an error with the reason
        if not found:
            raise InputError(
                self._path,
                found=f"no {'colour' if kind == 'color' else 'depth'} images, but {self._listed()}",
                expected="sensor_msgs/Image of colour, and of depth that is aligned to it",
            )
        return [topic for topic in found if topic == _base(topic) or _base(topic) not in found]

    def _apart(self, color: str, depth: str) -> str | None:
        """Why depth is not aligned to colour; None if there is no sign of that."""
        size = color_of(self._first[color], f"{self._path}, {color}").shape[1::-1]
        depth_size = depth_of(self._first[depth], f"{self._path}, {depth}").shape[::-1]
        if size != depth_size:
            return "depth of {} x {}, and colour of {} x {}".format(*depth_size, *size)
        unknown = _beside(depth) not in self._infos and self._topics.depth is None
        if unknown and _base(depth).endswith(_UNALIGNED) and not _base(color).endswith(_SAME_SENSOR):
            advice = " (if it is, name it: camera.depth_topic)" if self._can_name else ""
            return f"no CameraInfo of RealSense's own depth, which is not aligned to colour{advice}"
        if _beside(depth) not in self._infos:
            return None
        ours, its = self._infos[self._info_of(color)], self._infos[_beside(depth)]
        for name, tolerance in (("k", 0.01), ("d", 1e-6)):
            if not _same(field(ours, name), field(its, name), tolerance):
                return f"{name.upper()} in {_beside(depth)} that differs from that of {color}"
        return None

    def _info_of(self, color: str) -> str:
        named = self._topics.info
        if named is None and _beside(color) in self._infos:
            return _beside(color)
        if named is None and len(self._infos) == 1:
            return next(iter(self._infos))
        if named is None or named not in self._infos:
            raise InputError(
                self._path if named is None else f"camera.info_topic {named}",
                found=f"no CameraInfo {_beside(color)}" if named is None else "no CameraInfo of that name",
                expected=f"one of {', '.join(self._infos) or 'its topics (it has none)'}",
                fix=self._named_or(
                    "name another: camera.info_topic" if self._infos else "",
                    "record the camera_info of the colour camera.",
                ),
            )
        return named

    def _named_or(self, named: str, other: str) -> str:
        """What to do: `named` (if it is not empty, and topics can be named) or `other`."""
        fix = f"{named}, or {other}" if named and self._can_name else other
        return fix[0].upper() + fix[1:]

    def _listed(self) -> str:
        return ", ".join(f"{t} ({encoding_of(m)})" for t, m in self._first.items()) or "no images"


def _base(topic: str) -> str:
    """The topic without the suffix of a transport of image_transport."""
    return next((topic.removesuffix(t) for t in _TRANSPORTS if topic.endswith(t)), topic)


def _beside(topic: str) -> str:
    """The CameraInfo topic of an image topic, by convention."""
    return _base(topic).rpartition("/")[0] + "/camera_info"


def _partly(info: Any) -> str:
    """Binning and region of interest of a CameraInfo, which are not supported, in words; else empty."""
    binning, roi = f"{info.binning_x} x {info.binning_y}", info.roi
    parts = [f"binning {binning}"] if max(info.binning_x, info.binning_y) > 1 else []
    if roi.width and (roi.width, roi.height) != (info.width, info.height):
        parts.append(f"a roi of {roi.width} x {roi.height} at {roi.x_offset}, {roi.y_offset}")
    return f" with {' and '.join(parts)}, which is not supported" if parts else ""


def _same(one: Any, other: Any, tolerance: float) -> bool:
    """Whether numbers are the same, apart from zeros at the end."""
    a, b = (np.asarray(x, np.float64).ravel() for x in (one, other))
    a, b = (np.pad(x, (0, max(len(a), len(b)) - len(x))) for x in (a, b))
    return bool(np.allclose(a, b, rtol=0, atol=tolerance))
