"""Field types that several messages share, and the checks that a type alone cannot express.

Numbers are finite everywhere. Lengths are metres, angles radians, timestamps nanoseconds of CLOCK_MONOTONIC
on the machine named by `clock_id`. A pose is the translation and the unit quaternion (x, y, z, w) that take a
point from the object's frame to the camera's: x right, y down, z forward.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Annotated, Literal

from msgspec import Meta

MAJOR, MINOR = 1, 0
VERSION = f"{MAJOR}.{MINOR}"

_NAME = r"^[a-z0-9_-]{1,64}\Z"  # `$` of Python is also before a newline at the end
_UNIT_TOLERANCE = 1e-3

Version = Annotated[str, Meta(pattern=r"^\d{1,4}\.\d{1,4}\Z", description="major.minor of the wire contract")]
Name = Annotated[str, Meta(pattern=_NAME, description="[a-z0-9_-]{1,64}")]
Text = Annotated[str, Meta(max_length=2000)]
Stamp = Annotated[int, Meta(ge=0, le=2**63 - 1, description="nanoseconds, CLOCK_MONOTONIC of clock_id")]
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Index = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Epoch = Annotated[int, Meta(ge=0, le=2**63 - 1, description="random number, chosen when a camera is opened")]
Size = Annotated[int, Meta(ge=1, le=16384, description="pixels")]
Positive = Annotated[float, Meta(gt=0.0)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Vector3 = tuple[float, float, float]
Quaternion = Annotated[tuple[float, float, float, float], Meta(description="x y z w, of unit length")]
BoxXYWH = Annotated[
    tuple[float, float, float, float], Meta(description="x, y of the top-left corner, width, height; pixels")
]
Covariance = Annotated[
    list[float],
    Meta(
        min_length=36,
        max_length=36,
        description="6x6 row by row, order tx ty tz rx ry rz, metres and radians, about the object's origin, "
        "along the camera's axes",
    ),
]
StateName = Literal["SEARCHING", "TRACKING", "SUSPECT", "LOST"]
VerdictName = Literal["agree", "correct", "acquire", "reject"]
HealthState = Literal["starting", "ready", "waiting", "ended", "stopping"]


def is_name(text: str) -> bool:
    """Whether a site, camera, object or worker may have this name."""
    return re.fullmatch(_NAME, text) is not None


_FARTHEST_M = 1e8
"""Ten times the largest coordinate on a map of the earth; computations with much larger numbers fail."""


def check_finite(**groups: float | Iterable[float] | None) -> None:
    """Raise ValueError that names the first field with a NaN or an infinity."""
    for name, group in groups.items():
        if group is None:
            continue
        numbers = (group,) if isinstance(group, float | int) else group
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"{name} is not finite")


def check_pose(
    translation: Iterable[float] | None, quaternion: Iterable[float] | None, prefix: str = ""
) -> None:
    """Raise ValueError unless both are there and describe a rigid motion, or neither is there."""
    if (translation is None) != (quaternion is None):
        raise ValueError(f"{prefix}translation and {prefix}quaternion must be given together")
    check_finite(**{f"{prefix}translation": translation, f"{prefix}quaternion": quaternion})
    if translation is not None and max(map(abs, translation)) > _FARTHEST_M:
        raise ValueError(f"{prefix}translation is more than {_FARTHEST_M:.0e} m")
    if quaternion is not None and abs(math.hypot(*quaternion) - 1.0) > _UNIT_TOLERANCE:
        raise ValueError(f"{prefix}quaternion is not of unit length")


def check_covariance(covariance: list[float] | None) -> None:
    """Raise ValueError unless the numbers are finite and the variances not negative."""
    check_finite(covariance=covariance)
    if covariance is not None and min(covariance[::7]) < 0.0:
        raise ValueError("covariance has a negative variance")


def check_box(box: tuple[float, float, float, float] | None) -> None:
    """Raise ValueError unless the box is finite and its sides are not negative."""
    check_finite(box=box)
    if box is not None and (box[2] < 0.0 or box[3] < 0.0):
        raise ValueError("box has a negative side")


class WireError(ValueError):
    """Bytes from the bus that are refused; the text says why, in one short line for the log."""
