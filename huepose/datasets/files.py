"""Reads images and JSON from disk. Errors name the file, what is wrong, and what to do."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float32, Float64, UInt8
from huepose.support.errors import InputError
from huepose.support.picture_size import require_room
from huepose.support.words import listed

_COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")
_FRAME_NS = 1e9 / 30.0
_SQUARE = 1e-3
"""A skew of less than this share of the focal length is ignored: it moves no point by half a pixel."""


def folder_name(path: Path) -> str:
    """The name of a folder, also for a relative path; links are not resolved."""
    return os.path.basename(os.path.abspath(path))


def stamp_at_30_hz(number: int) -> int:
    """Nanoseconds of frame `number` of a 30 Hz recording without timestamps."""
    return round(number * _FRAME_NS)


def read_bytes(path: Path, fix: str = "") -> bytes:
    """The content of a file. Raises InputError if it is missing or cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(path, found="no such file", fix=fix or "Check the path.") from None
    except OSError as error:
        raise InputError(path, found=error.strerror or str(error), expected="a readable file") from None


def read_json(path: Path, fix: str = "", form: str = "") -> dict[str, Any]:
    """A JSON object. fix, form: what to do if the file is missing, and if it is not JSON. Raises InputError
    if the file is missing, is not JSON, or has no object."""
    content = read_bytes(path, fix)
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(
            path, found=f"no valid JSON ({str(error)[:200]})", fix=form or "Write the file again."
        ) from None
    if not isinstance(value, dict):
        raise InputError(path, found=f"a JSON {type(value).__name__}", expected="a JSON object")
    return value


def field(record: dict[str, Any], key: str, where: object) -> Any:
    """`record[key]`. Raises InputError, naming `where`, if it is not there."""
    if not isinstance(record, dict) or key not in record:
        found = f"keys {in_words(record) or 'none'}" if isinstance(record, dict) else f"{record!r}"
        raise InputError(where, found=found, expected=f"the key '{key}'")
    return record[key]


def in_words(keys: Iterable[str]) -> str:
    """Keys in order, shortened if there are many; consecutive numbers as one range.

    >>> in_words(["fy", "fx"]), in_words(["10", "9", "8", "0"]), in_words(map(str, range(1000)))
    ('fx, fy', '0, 8 to 10', '0 to 999')
    """
    names = list(keys)
    if not all(name.isdecimal() for name in names):
        return listed(sorted(names))
    runs: list[list[int]] = []
    for number in sorted(map(int, names)):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return listed([f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs])


def numbers(record: dict[str, Any], key: str, shape: tuple[int, ...], where: object) -> Float64:
    """`record[key]` as finite float64 numbers in this shape (() is one number). Raises InputError."""
    value = field(record, key, where)
    count = int(np.prod(shape))
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.size != count or not np.isfinite(array).all():
        shown = repr(value) if len(repr(value)) < 60 else f"{repr(value)[:56]} ..."
        raise InputError(
            where, found=f"'{key}': {shown}", expected=f"{count} finite number{'s'[: count > 1]}"
        )
    return array.reshape(shape)


def positive(record: dict[str, Any], key: str, where: object) -> float:
    """`record[key]` as a number over 0. Raises InputError."""
    value = float(numbers(record, key, (), where))
    if value <= 0:
        raise InputError(where, found=f"'{key}': {value}", expected="a number over 0")
    return value


def pinhole(K: Float64, where: object) -> Float64:
    """The camera matrix K (3, 3) of a file. Raises InputError if it is not that of a pinhole camera without
    skew."""
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise InputError(where, found=f"focal lengths {K[0, 0]}, {K[1, 1]}", expected="numbers over 0")
    if K[2].tolist() != [0.0, 0.0, 1.0]:
        raise InputError(
            where,
            found=f"a matrix whose last row is {K[2].tolist()}",
            expected="0, 0, 1",
            fix="cam_K and K are row by row: fx, 0, cx, 0, fy, cy, 0, 0, 1; intrinsic_matrix is by columns.",
        )
    skew = max(K[0, 1], K[1, 0], key=abs)
    if abs(skew) > _SQUARE * K[0, 0]:
        raise InputError(
            where,
            found=f"a skew of {skew:g} beside the focal lengths {K[0, 0]:g}, {K[1, 1]:g}",
            expected="0: fx, 0, cx, 0, fy, cy, 0, 0, 1, row by row",
            fix="Rectify the images to a matrix without skew (OpenCV: cv2.undistort with such a "
            "newCameraMatrix), and give that matrix.",
        )
    return K


def rigid(R: Float64, t_m: Float64, where: object) -> Float64:
    """T (4, 4) from the rotation and translation of a file; rounding errors of the rotation are removed.
    Raises InputError if R is not a rotation."""
    if not np.allclose(R.T @ R, np.eye(3), atol=1e-2) or np.linalg.det(R) < 0:
        raise InputError(
            where, found="a matrix that is no rotation", expected="orthonormal rows, determinant 1"
        )
    return se3.orthonormalised(se3.make(R, t_m))


def _decode(path: Path, flags: int) -> np.ndarray:
    content = read_bytes(path)
    require_room(content, path)
    data = np.frombuffer(content, dtype=np.uint8)
    try:
        image = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(path, found="no image that can be decoded", fix="Copy or export the file again.")
    return image


def read_color(path: Path) -> UInt8:
    """Colour image (H, W, 3) uint8 RGB. Grey images become RGB, alpha is dropped. Raises InputError."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = _decode(path, flags)
    if image.dtype != np.uint8:
        raise InputError(
            path,
            found=f"{image.dtype} values",
            expected="a colour image with 8 bit values",
            fix="Give the colour image here; 16 bit values are usually depth.",
        )
    return np.ascontiguousarray(image[..., ::-1])


_SAVE_METRES = (
    "If depth is in metres, save millimetres: cv2.imwrite('depth.png', (depth * 1000).astype(np.uint16)), "
    "with 0.001 as 'depth_scale_m'."
)


def _instead_of(depth: np.ndarray) -> str:
    """What to save instead of an image that does not have 16 bit depth values."""
    if depth.ndim == 2 and depth.dtype.kind == "f":
        return _SAVE_METRES
    if depth.ndim == 2 and depth.dtype == np.uint8:
        return "8 bits have only 256 steps: save the camera's own values with 16 bits."
    return "Save the depth values themselves, not a coloured image of them."


def read_depth(path: Path, scale_m: float) -> Float32:
    """Depth (H, W) float32 metres from an image of 16 bit values times `scale_m`; 0 = no reading."""
    if path.suffix.lower() in (".npy", ".npz"):
        raise InputError(
            path, found="an array of numpy", expected="an image with 16 bit values", fix=_SAVE_METRES
        )
    image = _decode(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint16:
        channels = 1 if image.ndim == 2 else image.shape[2]
        raise InputError(
            path,
            found=f"{image.dtype} values in {channels} channel{'s'[: channels > 1]}",
            expected="one channel with 16 bit values",
            fix=_instead_of(image),
        )
    return np.asarray(image * np.float32(scale_m), dtype=np.float32)


def read_float_depth(path: Path, fix: str = "") -> Float32:
    """Fast-YCB's `.float`: width and height as little-endian uint64, then float32 metres row by row.

    Values that are not finite or not positive become 0. Raises InputError if the size does not fit."""
    data = read_bytes(path, fix)
    width, height = (int(v) for v in np.frombuffer(data[:16], "<u8")) if len(data) >= 16 else (0, 0)
    if width * height == 0 or len(data) != 16 + 4 * width * height:
        raise InputError(
            path,
            found=f"{len(data)} bytes for {width} x {height} pixels",
            expected="16 bytes of size, then 4 bytes per pixel",
            fix="Copy the file again.",
        )
    depth = np.frombuffer(data, "<f4", offset=16).reshape(height, width)
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)


def read_mask(path: Path) -> Bool:
    """Mask (H, W): pixels over 0. Raises InputError."""
    image = _decode(path, cv2.IMREAD_UNCHANGED)
    return np.asarray((image if image.ndim == 2 else image[..., :3].max(2)) > 0)


def same_size(color: UInt8, color_path: Path, other: np.ndarray, other_path: Path) -> None:
    """Raises InputError if two images of one frame differ in size."""
    if color.shape[:2] != other.shape[:2]:
        raise InputError(
            other_path,
            found=f"{other.shape[1]} x {other.shape[0]} pixels",
            expected=f"{color.shape[1]} x {color.shape[0]} as in {color_path}",
            fix="Align depth to colour when recording, or check that the files belong together.",
        )


def numbered_files(folder: Path) -> dict[int, Path]:
    """Image files whose name is a number, by number, ascending. Raises InputError."""
    if not folder.is_dir():
        raise InputError(folder, found="no such folder", fix="Check the path of the scene.")
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        digits = path.stem
        if path.suffix.lower() in _COLOR_SUFFIXES and digits.isascii() and digits.isdigit():
            found.setdefault(int(digits), path)
    return dict(sorted(found.items()))


def gaps(folder: Path, parts: Mapping[str, Collection[int]], numbers: Collection[int]) -> list[str]:
    """One sentence for each part of a scene in which some of its images are missing; these images are left
    out when the scene is played. parts: the image numbers in each part, by its name."""
    missing = {part: sorted(set(numbers) - set(present)) for part, present in parts.items()}
    return [
        f"{folder}: {part} lacks {len(absent)} of {len(numbers)} images, the first is number {absent[0]}; "
        "they are left out when it is played"
        for part, absent in missing.items()
        if absent
    ]


_FILMS = frozenset({".mp4", ".mov", ".avi", ".mkv", ".webm"})


def instead_of_film(path: Path) -> str:
    """What to give instead of a video without depth, in a sentence; empty for other files.

    >>> instead_of_film(Path("run.mcap"))
    ''
    """
    if path.suffix.lower() not in _FILMS:
        return ""
    return (
        "A video has no depth, which HuePose needs: record colour with depth, by `huepose record` of a "
        "pipeline with the camera, or as a ROS bag."
    )
