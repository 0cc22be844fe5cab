"""One frame from three files: a colour image, a depth image, and a JSON with the camera's intrinsics.

Forms of the JSON: the intrinsics are `fx fy cx cy`, or nine numbers as `cam_K` or `K` (row by row), or
Open3D's `intrinsic_matrix` (column by column). The unit of depth is `depth_scale_m` (metres per depth value)
or BOP's `depth_scale` (millimetres per depth value), or both if they agree. `width height`, and
`distortion_model` with `distortion`, may be left out. In BOP's `scene_camera.json` the entry of the image
number is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.datasets.rectify import Rectifier, checked_coefficients
from huepose.geometry.arrays import Float32, Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError

NEAREST_M, FARTHEST_M = 0.02, 50.0
"""If the median depth of an image is outside this range, it was read with the wrong unit."""

FORMS = (
    "fx, fy, cx, cy (or K or cam_K, nine numbers row by row, or Open3D's intrinsic_matrix), width, height, "
    "depth_scale_m, and for a distorted lens distortion_model (brown_conrady, plumb_bob, rational) with "
    "distortion, as in OpenCV"
)
"""The possible content of a camera's JSON, in words."""

_OTHER_NAMES = frozenset(
    {"d", "dist", "disto", "coeffs", "dist_coeffs", "distcoeffs", "distortion_coefficients"}
    | {"distortion_coeffs", "dist_coeff", *(f"k{n}" for n in range(1, 7)), "p1", "p2"}
)
"""Other names of `distortion`, in lower case. If it were ignored, images would be wrong near their border."""


@dataclass(frozen=True, eq=False)
class CameraFile:
    """Intrinsics from a file. width, height, depth_scale_m: None if the file does not have them; distortion:
    OpenCV's coefficients, empty for a pinhole camera."""

    path: Path
    K: Float64
    width: int | None
    height: int | None
    depth_scale_m: float | None
    distortion: Float64

    def camera(self, width: int, height: int, image: Path) -> Camera:
        """The camera of an image of this size. Raises InputError if the file has another size."""
        if (self.width or width, self.height or height) != (width, height):
            raise InputError(
                image,
                found=f"{width} x {height} pixels",
                expected=f"{self.width} x {self.height} as in {self.path}",
                fix="Use the intrinsics of this resolution.",
            )
        return Camera.from_matrix(self.K, width, height)


def read_camera(path: Path | str, image: int | None = None) -> CameraFile:
    """Intrinsics in any of the forms above; `image` picks the entry of a `scene_camera.json`.

    Raises InputError that names the file and the key."""
    path = Path(path)
    record = files.read_json(
        path,
        "Write the camera's intrinsics to it: fx, fy, cx, cy, width, height, depth_scale_m.",
        f"A camera file is JSON with {FORMS}.",
    )
    where = str(path)
    if record and all(key.isdigit() and isinstance(value, dict) for key, value in record.items()):
        if str(image) not in record:
            raise InputError(
                path,
                found=f"no entry for image {image}",
                expected=f"one of its entries, {files.in_words(record)}",
                fix="The number at the end of the colour image's name chooses the entry; without one, 0.",
            )
        record, where = record[str(image)], f"{path}, image {image}"
    if overlooked := [key for key in record if key.lower() in _OTHER_NAMES]:
        raise InputError(
            where,
            found=f"the key '{overlooked[0]}'",
            expected="distortion under 'distortion', with its 'distortion_model'",
            fix=f"A camera file holds {FORMS}.",
        )
    return CameraFile(
        path,
        _matrix(record, where),
        _size(record, "width", where),
        _size(record, "height", where),
        _depth_scale_m(record, where),
        checked_coefficients(record.get("distortion_model", "none"), record.get("distortion", []), where),
    )


def _matrix(record: dict[str, Any], where: str) -> Float64:
    if key := next((key for key in ("cam_K", "K") if key in record), None):
        K = files.numbers(record, key, (3, 3), where)
    elif "intrinsic_matrix" in record:
        K = files.numbers(record, "intrinsic_matrix", (3, 3), where).T  # Open3D stores it by columns
    elif not {"fx", "fy", "cx", "cy"} & set(record):
        raise InputError(
            where,
            found=f"keys {', '.join(sorted(record)) or 'none'}"[:200],
            expected="intrinsics",
            fix=f"A camera file holds {FORMS}.",
        )
    else:
        fx, fy = files.positive(record, "fx", where), files.positive(record, "fy", where)
        cx, cy = (float(files.numbers(record, key, (), where)) for key in ("cx", "cy"))
        K = Camera(fx, fy, cx, cy, 1, 1).K
    return files.pinhole(K, where)


def _size(record: dict[str, Any], key: str, where: str) -> int | None:
    return int(files.positive(record, key, where)) if key in record else None


def _depth_scale_m(record: dict[str, Any], where: str) -> float | None:
    scales = {"depth_scale_m": 1.0, "depth_scale": 0.001}
    given = {key: files.positive(record, key, where) * m for key, m in scales.items() if key in record}
    if len(given) == 2 and not math.isclose(*given.values(), rel_tol=1e-6):
        raise InputError(
            where,
            found=f"'depth_scale_m': {record['depth_scale_m']} beside 'depth_scale': {record['depth_scale']}",
            expected="one of them, or the same scale in both",
            fix="'depth_scale_m' is metres per depth value, BOP's 'depth_scale' millimetres.",
        )
    return next(iter(given.values()), None)


def read_frame(
    color: Path | str,
    depth: Path | str,
    camera: Path | str,
    *,
    frame_id: int | None = None,
    stamp_ns: int | None = None,
) -> RgbdFrame:
    """The frame of three files, rectified.

    depth: 16 bit image, or Fast-YCB's `.float`. frame_id, stamp_ns: frame number and capture time, which must
    increase from frame to frame; by default the number at the end of the colour file's name (0 without one),
    and the time of this number at 30 Hz. Raises InputError, naming the file and what to do."""
    color_path, depth_path = Path(color), Path(depth)
    number = _number(color_path)
    image = files.read_color(color_path)
    intrinsics = read_camera(camera, number)
    if depth_path.suffix == ".float":
        depth_m = files.read_float_depth(depth_path)
    elif intrinsics.depth_scale_m is None:
        raise InputError(
            intrinsics.path,
            found="no depth scale",
            expected="'depth_scale_m', metres per depth value",
            fix="For a RealSense it is 0.001: 16 bit values are millimetres.",
        )
    else:
        depth_m = files.read_depth(depth_path, intrinsics.depth_scale_m)
    files.same_size(image, color_path, depth_m, depth_path)
    _check_units(depth_m, depth_path, intrinsics.path)
    pinhole = intrinsics.camera(image.shape[1], image.shape[0], color_path)
    rectifier = Rectifier.of(pinhole, intrinsics.distortion)
    frame_id = number if frame_id is None else frame_id
    stamp_ns = files.stamp_at_30_hz(frame_id) if stamp_ns is None else stamp_ns
    return RgbdFrame(rectifier.color(image), rectifier.depth(depth_m), pinhole, frame_id, stamp_ns)


def _number(path: Path) -> int:
    """The number at the end of a file's name, 0 without one."""
    digits = path.stem[len(path.stem.rstrip("0123456789")) :]
    return int(digits or 0)


def _check_units(depth_m: Float32, path: Path, camera: Path) -> None:
    """Raises InputError if there is no depth, or if it is outside the range of cameras: then its unit is
    wrong."""
    readings = depth_m[depth_m > 0]
    if not readings.size:
        raise InputError(path, found="no depth in any pixel", expected="a depth image; 0 is no reading")
    median_m = float(np.median(readings))
    if not NEAREST_M < median_m < FARTHEST_M:
        raise InputError(
            path,
            found=f"a median depth of {median_m:.{3 if median_m < 10 else 0}f} m",
            expected=f"{NEAREST_M:g} to {FARTHEST_M:g} m",
            fix=f"Correct the depth scale in {camera}: 'depth_scale_m' is metres per depth value, "
            "BOP's 'depth_scale' millimetres.",
        )
