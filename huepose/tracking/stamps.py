"""Checks the timestamps of frames: without time nothing is known about the motion of an object."""

from __future__ import annotations

import numpy as np

from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError

LEAST_GAP_NS = 100_000
"""No camera takes 10,000 images a second: timestamps that are closer are in another unit, or missing."""

NEVER_NS = -(1 << 62)
"""Before any timestamp, which may be negative."""

IN_A_ROW = 3
"""This many frames in a row without time between them are neither a clock that was set back once, nor two
frames with one timestamp."""

_FIX = "Give RgbdFrame(..., frame_id=number, stamp_ns=round(seconds * 1e9)), or the same to read_frame."


def without_time(before: int, newest: RgbdFrame, frame: RgbdFrame) -> int:
    """How many frames in a row had no time between them, `before` up to the newest one. Raises InputError for
    the third of them."""
    count = before + 1 if frame.stamp_ns - newest.stamp_ns < LEAST_GAP_NS else 0
    if count < IN_A_ROW:
        return count
    raise InputError(
        f"frame {frame.frame_id}",
        found=f"{frame.stamp_ns} ns after one of {newest.stamp_ns} ns, the third such step in a row",
        expected="the time when each image was taken, in nanoseconds",
        fix=_FIX,
    )


def repeats(newest: RgbdFrame, frame: RgbdFrame) -> bool:
    """Whether a frame is the newest one once more, perhaps with another number."""
    return frame.stamp_ns == newest.stamp_ns and np.array_equal(frame.color, newest.color)


def refuse_another_image(newest: RgbdFrame, frame: RgbdFrame) -> None:
    """Raises InputError if a frame has the number and timestamp of the newest one, but another image."""
    same = frame.frame_id == newest.frame_id and frame.stamp_ns == newest.stamp_ns
    if same and not repeats(newest, frame):
        raise InputError(
            f"frame {frame.frame_id}",
            found=f"another image with the same number and timestamp, {frame.stamp_ns} ns",
            expected="a number and a timestamp of its own for each image",
            fix=_FIX,
        )
