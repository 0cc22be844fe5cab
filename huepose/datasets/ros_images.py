"""Images of ROS: converts `sensor_msgs` Image, CompressedImage and CameraInfo to arrays and a camera.

A message is any object with the fields of its type, as from rosbags. Encodings: sensor_msgs/image_encodings
and REP 118; compressed: those of compressed_image_transport and compressed_depth_image_transport.
"""

from __future__ import annotations

from typing import Any, Literal

import cv2
import numpy as np

from huepose.datasets.rectify import Rectifier, checked_coefficients
from huepose.geometry.arrays import Float32, UInt8
from huepose.geometry.camera import Camera
from huepose.support.errors import InputError
from huepose.support.picture_size import require_room

# Indices of the red, green and blue channel, and the number of channels.
_CHANNELS = {
    **{"rgb8": ([0, 1, 2], 3), "bgr8": ([2, 1, 0], 3)},
    **{"rgba8": ([0, 1, 2], 4), "bgra8": ([2, 1, 0], 4)},
}
_METRES = {"16UC1": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_DEPTH_PNG = "16UC1; compressedDepth"
_DEPTH_PNG_AT = 12
"""Number of bytes that compressed_depth_image_transport writes before the PNG."""

Kind = Literal["color", "depth"]
_WANTED: dict[Kind, tuple[str, str]] = {
    "color": (
        f"{', '.join(_CHANNELS)}, or a compressed one of these (jpeg, png)",
        "HuePose finds objects by their colours: record the driver's colour topic (mono8 has no colour; "
        "image_proc converts bayer_* to colour).",
    ),
    "depth": (
        "16UC1 (millimetres), 32FC1 (metres), or 16UC1 as compressedDepth in PNG",
        "HuePose needs depth: record the driver's depth topic.",
    ),
}
"""Expected encodings for each kind of image, and what to do if an image has another."""


def kind_of(message: Any) -> Kind | None:
    """Whether an image is colour or depth; None if it is neither."""
    encoding = encoding_of(message)
    if encoding in _METRES or (encoding.startswith(_DEPTH_PNG) and "rvl" not in encoding.lower()):
        return "depth"
    if encoding in _CHANNELS or (_is_compressed(message) and _has_colours(encoding)):
        return "color"
    return None


def encoding_of(message: Any) -> str:
    """The encoding of an image; of a compressed one its format: `jpeg`, `rgb8; jpeg compressed bgr8`, ..."""
    return str(message.format if _is_compressed(message) else message.encoding)


def color_of(message: Any, where: object) -> UInt8:
    """The colour image (H, W, 3) RGB. Raises InputError, naming `where`, if it is not one or is broken."""
    encoding = _encoding_for(message, "color", where)
    if not _is_compressed(message):
        order, channels = _CHANNELS[encoding]
        return np.ascontiguousarray(_pixels(message, "u1", channels, where)[..., order], dtype=np.uint8)
    image = _decoded(message.data, 3, np.uint8, where)
    # The format says if the sender converted RGB to BGR for the codec. If not, the decoded image is RGB.
    as_sent = ";" in encoding and "compressed bgr" not in encoding and encoding.startswith("rgb")
    return np.ascontiguousarray(image[..., [0, 1, 2] if as_sent else [2, 1, 0]], dtype=np.uint8)


def depth_of(message: Any, where: object) -> Float32:
    """The depth (H, W) float32 metres, 0 for no reading. Raises InputError if the image is not depth."""
    encoding = _encoding_for(message, "depth", where)
    if _is_compressed(message):
        image = _decoded(np.asarray(message.data)[_DEPTH_PNG_AT:], 2, np.uint16, where)
        scale = _METRES["16UC1"][1]
    else:
        dtype, scale = _METRES[encoding]
        image = _pixels(message, dtype, 1, where)[..., 0]
    metres = image.astype(np.float32) * np.float32(scale)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))


def camera_of(info: Any, rectified: bool, where: object) -> tuple[Camera, Rectifier]:
    """The camera of a CameraInfo, and the rectifier of its images. rectified: the images are already
    rectified, so the intrinsics are those of P. Raises InputError if the camera is not calibrated."""
    K = np.asarray(field(info, "p") if rectified else field(info, "k"), np.float64)
    K = K.reshape(3, -1)[:, :3]
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise InputError(
            where,
            found=f"a focal length of {K[0, 0]:g}",
            expected="a calibrated camera",
            fix="Calibrate it (camera_calibration) and record again.",
        )
    camera = Camera.from_matrix(K, int(info.width), int(info.height))
    coefficients = [] if rectified else [float(x) for x in field(info, "d")]
    if not any(coefficients):
        return camera, Rectifier(None)
    return camera, Rectifier.of(camera, checked_coefficients(str(info.distortion_model), coefficients, where))


def field(info: Any, name: str) -> Any:
    """A matrix of CameraInfo; its name is a capital letter in ROS 1."""
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def _encoding_for(message: Any, kind: Kind, where: object) -> str:
    """The encoding of an image of this kind. Raises InputError for an image of another kind."""
    encoding = encoding_of(message)
    if kind_of(message) == kind:
        return encoding
    expected, fix = _WANTED[kind]
    raise InputError(where, found=f"an image with the encoding '{encoding}'", expected=expected, fix=fix)


def _is_compressed(message: Any) -> bool:
    return hasattr(message, "format")


def _has_colours(encoding: str) -> bool:
    """Whether a compressed image may have colours, by its format."""
    return ("jpeg" in encoding or "jpg" in encoding or "png" in encoding) and not (
        encoding.startswith(("mono", "16UC1", "32FC1", "8UC1")) or "compressedDepth" in encoding
    )


def _pixels(message: Any, dtype: str, channels: int, where: object) -> Any:
    """The pixels (H, W, channels), without the padding of rows."""
    kind = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, np.uint8)
    used = width * channels * kind.itemsize
    if height * width == 0 or step < used or len(data) < height * step:
        raise InputError(
            where, found=f"{len(data)} bytes for {width} x {height}", expected=f"{height} rows of {used}"
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :used])
    return rows.view(kind).reshape(height, width, channels)


def _decoded(data: Any, axes: int, dtype: type, where: object) -> Any:
    """The decoded image. Raises InputError if it does not have this number of axes and this type."""
    data = np.asarray(data, np.uint8)
    require_room(data.tobytes(), where)
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except cv2.error:
        image = None
    if image is None:
        raise InputError(where, found="an image that cannot be decoded", expected="a complete JPEG or PNG")
    if image.ndim != axes or image.dtype != dtype:
        raise InputError(
            where,
            found=f"an image of {image.shape} {image.dtype}",
            expected="three colours of 8 bits" if axes == 3 else "depth of 16 bits",
        )
    return image
