"""Whether frames tell the time: without it nothing can be said of how an object moves."""

from __future__ import annotations

import numpy as np

from huepose.geometry.frame import RgbdFrame
from huepose.support.errors import InputError

LEAST_GAP_NS = 100_000
"""No camera takes 10,000 pictures a second: stamps that lie nearer are in another unit, or none."""

IN_A_ROW = 3
"""So many frames without time between them are no clock that was set back once, nor a pair of one stamp."""

_FIX = "Give RgbdFrame(..., frame_id=number, stamp_ns=round(seconds * 1e9)), or the same to read_frame."


def without_time(before: int, newest: RgbdFrame, frame: RgbdFrame) -> int:
    """For how many frames in a row no time has passed, of them `before` until the newest one. Raises
    InputError for the third of them."""
    count = before + 1 if frame.stamp_ns - newest.stamp_ns < LEAST_GAP_NS else 0
    if count < IN_A_ROW:
        return count
    raise InputError(
        f"frame {frame.frame_id}",
        found=f"{frame.stamp_ns} ns after one of {newest.stamp_ns} ns, the third such step in a row",
        expected="the time when each picture was taken, in nanoseconds",
        fix=_FIX,
    )


def refuse_another_picture(newest: RgbdFrame, frame: RgbdFrame) -> None:
    """Raises InputError where a frame has number and stamp of the newest one, and another picture."""
    same = frame.frame_id == newest.frame_id and frame.stamp_ns == newest.stamp_ns
    if same and not np.array_equal(frame.color, newest.color):
        raise InputError(
            f"frame {frame.frame_id}",
            found=f"another picture of the same number and stamp, {frame.stamp_ns} ns",
            expected="a number and a stamp of its own for each picture",
            fix=_FIX,
        )
