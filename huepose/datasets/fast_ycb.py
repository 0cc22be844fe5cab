"""Sequences of the Fast-YCB data set (ROFT, doi 10.48557/G2QJDM) in their published layout.

`rgb/N.png`, `depth/N.float`, `masks/gt/OBJECT_N.png`, `gt/poses_ycb.txt` (for each frame a row
`x y z ax ay az angle`, metres, PoseCNN's model frame), `cam_K.json`, `data.txt` (for each frame a line
that begins with its timestamp in seconds). The object has the name of the folder without a trailing `_real`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from huepose.datasets import files
from huepose.datasets.image_files import read_camera
from huepose.datasets.types import GroundTruth
from huepose.datasets.ycb_objects import T_posecnn_obj
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, UInt8
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError
from huepose.support.files import write_picture, writing

_UNPACK = "The packed form must be unpacked first: rgb/N.png, depth/N.float, masks/gt/OBJECT_N.png."


def object_of(path: Path | str) -> str:
    """Name of the object that a sequence folder shows.

    >>> object_of("fast/006_mustard_bottle_real")
    '006_mustard_bottle'
    """
    return files.folder_name(Path(path)).removesuffix("_real")


def labelled_sequences(path: Path | str) -> tuple[list[Path], list[str]]:
    """The labelled sequences of a download, by name, and notes on what is missing or left out.

    path: the folder of the data set, or one sequence. Raises InputError if there is no labelled sequence."""
    root = Path(path)
    folders = [root] if (root / "rgb").is_dir() else sorted(p for p in root.glob("*") if p.is_dir())
    found, notes = [], []
    for folder in folders:
        name, colors = files.folder_name(folder), len(list(folder.glob("rgb/*")))
        if not colors:
            notes += [f"{name}: no rgb/, left out"] if (folder / "cam_K.json").exists() else []
        elif not (folder / "gt" / "poses_ycb.txt").exists():
            notes.append(f"{name}: no gt/poses_ycb.txt, so not labelled; left out")
        else:
            stated = len(files.read_bytes(folder / "data.txt").splitlines())
            depths = len(list(folder.glob("depth/*.float")))
            found.append(folder)
            if min(colors, depths) < stated:
                notes.append(
                    f"{name}: {colors} colour images and {depths} depth files of {stated} frames are there"
                )
    if not found:
        raise InputError(
            root,
            found="; ".join(notes) or "no sequence",
            expected="sequences with rgb/, depth/, gt/poses_ycb.txt, cam_K.json and data.txt",
            fix=_UNPACK,
        )
    return found, notes


def axis_angle_poses(path: Path) -> Float64:
    """Poses (N, 4, 4) of rows `x y z ax ay az angle`; a row of zeros is a missing pose and gives nan.

    Raises InputError if a row does not have seven finite numbers, or an axis has length 0."""
    poses = []
    for line, text in enumerate(files.read_bytes(path).decode("utf-8", "replace").splitlines(), 1):
        if not text.strip():
            continue
        row = _numbers_of(text)
        if row is None or len(row) != 7:
            raise InputError(f"{path}, line {line}", found=text.strip()[:60], expected="x y z ax ay az angle")
        if not row.any():
            poses.append(np.full((4, 4), np.nan))
            continue
        length = float(np.linalg.norm(row[3:6]))
        if length < 1e-9 and abs(row[6]) > 1e-9:
            raise InputError(
                f"{path}, line {line}", found="a rotation axis of length 0", expected="a unit axis"
            )
        axis = row[3:6] / length if length > 0 else np.zeros(3)
        poses.append(se3.make(se3.rotation_exp(axis * row[6]), row[:3]))
    return np.asarray(poses).reshape(-1, 4, 4)


def _numbers_of(text: str) -> Float64 | None:
    try:
        row = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        return None
    return row if np.isfinite(row).all() else None


class FastYcbSequence:
    """One sequence. frame_offset_m (3,): offset from the PoseCNN frame to the reference model's, added to
    points (the model's `frame_offset_m`); None if unknown: then the labels have no pose."""

    def __init__(self, path: Path | str, frame_offset_m: Float | None) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise InputError(self.path, found="no such folder", expected="a Fast-YCB sequence")
        self.name = files.folder_name(self.path)
        self.object = object_of(path)
        self._offset = None if frame_offset_m is None else np.asarray(frame_offset_m, dtype=np.float64)
        self._colors = files.numbered_files(self.path / "rgb")
        if not self._colors:
            raise InputError(
                self.path / "rgb", found="no image named by a number", expected="0.png and so on"
            )
        self._stamps = self._read_stamps()
        self._camera = read_camera(self.path / "cam_K.json")
        if len(self._camera.distortion):
            raise InputError(
                self._camera.path, found="a distorted lens", expected="rectified images, and their intrinsics"
            )
        poses_path = self.path / "gt" / "poses_ycb.txt"
        self._poses = axis_angle_poses(poses_path) if poses_path.exists() else np.empty((0, 4, 4))
        if len(self._poses) and self.image_ids[-1] >= len(self._poses):
            raise InputError(
                poses_path,
                found=f"{len(self._poses)} poses",
                expected=f"one for each frame up to {self.image_ids[-1]}",
            )
        self._masks = self._find_masks()

    @property
    def image_ids(self) -> tuple[int, ...]:
        """Numbers of the images on disk, ascending."""
        return tuple(self._colors)

    @property
    def with_depth(self) -> tuple[int, ...]:
        """The `image_ids` that have a depth file."""
        there = self._depths()
        return tuple(image for image in self._colors if image in there)

    def gaps(self) -> list[str]:
        """Missing images, one sentence for each part of the folder; no image is read."""
        depths = self._depths()
        return files.gaps(self.path, {"rgb/": self._colors, "depth/": depths}, {*self._colors, *depths})

    def _depths(self) -> set[int]:
        stems = [path.stem for path in self.path.glob("depth/*.float") if path.stem.isdecimal()]
        return {int(stem) for stem in stems if str(int(stem)) == stem}

    def _read_stamps(self) -> Float64 | None:
        """Seconds by frame number; None if those in `data.txt` do not increase, or are only frame numbers."""
        lines = files.read_bytes(self.path / "data.txt").decode("utf-8", "replace").splitlines()
        rows = [_numbers_of(text) for text in lines if text.strip()]
        first = np.array([row[0] if row is not None and len(row) else np.nan for row in rows])
        counts = np.array_equal(first, np.arange(len(first)))
        if len(first) <= self.image_ids[-1] or counts or not (np.diff(first) > 0).all():
            return None
        return first

    def _find_masks(self) -> dict[int, Path]:
        pattern = re.compile(re.escape(self.object) + r"(?:_real)?_(\d+)")
        found = {}
        for path in sorted((self.path / "masks" / "gt").glob("*.png")):
            match = pattern.fullmatch(path.stem)
            if match:
                found[int(match.group(1))] = path
        return found

    def stamp_ns(self, image: int) -> int:
        """The timestamp in `data.txt`, else the time of the frame number at 30 Hz."""
        return files.stamp_at_30_hz(image) if self._stamps is None else round(self._stamps[image] * 1e9)

    def frame(self, image: int) -> RgbdFrame:
        """Colour and depth of a frame. Raises InputError, naming the file."""
        if image not in self._colors:
            raise InputError(self.path / "rgb", found=f"no image {image}", expected="a number in `image_ids`")
        color_path, depth_path = self._colors[image], self.path / "depth" / f"{image}.float"
        color = files.read_color(color_path)
        depth = files.read_float_depth(depth_path, _UNPACK)
        files.same_size(color, color_path, depth, depth_path)
        camera = self._camera.camera(color.shape[1], color.shape[0], color_path)
        return RgbdFrame(color, depth, camera, frame_id=image, stamp_ns=self.stamp_ns(image))

    def truths(self, image: int) -> tuple[GroundTruth, ...]:
        """The one label of a frame; its pose is None if it is missing or the sequence is not labelled."""
        T_cam_obj = None
        if self._offset is not None and len(self._poses) and np.isfinite(self._poses[image]).all():
            T_cam_obj = se3.compose(self._poses[image], se3.make(np.eye(3), -self._offset))
        loader = partial(files.read_mask, self._masks[image]) if image in self._masks else None
        return (GroundTruth(0, T_cam_obj, object=self.object, mask_loader=loader),)


@dataclass(frozen=True, eq=False)
class FastYcbFrame:
    """color (H, W, 3) uint8 RGB, depth (H, W) float32 m, the object's visible mask (H, W) and T_cam_obj."""

    color: UInt8
    depth: Float32
    mask: Bool
    T_cam_obj: Float64


def write_fast_ycb(
    folder: Path,
    name: str,
    frames: Iterable[FastYcbFrame],
    camera: Camera,
    rate_hz: float,
    frame_offset_m: Float | None,
) -> None:
    """Write a sequence of the object `name`. `gt/poses_ycb.txt` is written last: if it exists, the sequence
    is complete. frame_offset_m (3,): offset from the PoseCNN frame to the reference model's, added to
    points; None: 0. Raises InputError."""
    T_obj_posecnn = se3.inverse(T_posecnn_obj(np.zeros(3) if frame_offset_m is None else frame_offset_m))
    rows = []
    with writing(folder):
        for part in ("depth", "gt"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        size = np.array([camera.width, camera.height], "<u8").tobytes()
        for i, frame in enumerate(frames):
            write_picture(folder / "rgb" / f"{i}.png", frame.color)
            (folder / "depth" / f"{i}.float").write_bytes(size + frame.depth.astype("<f4").tobytes())
            write_picture(folder / "masks" / "gt" / f"{name}_{i}.png", np.uint8(255) * frame.mask)
            rows.append(_row(se3.compose(frame.T_cam_obj, T_obj_posecnn)))
        facts = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        (folder / "cam_K.json").write_text(json.dumps(facts))
        (folder / "data.txt").write_text("".join(f"{i / rate_hz:.6f}\n" for i in range(len(rows))))
        (folder / "gt" / "poses_ycb.txt").write_text("\n".join(rows) + "\n")


def _row(T: Float64) -> str:
    """`x y z ax ay az angle`."""
    turn = se3.rotation_log(T[:3, :3])
    angle = float(np.linalg.norm(turn))
    return " ".join(f"{x:.9f}" for x in (*T[:3, 3], *(turn / max(angle, 1e-12)), angle))
