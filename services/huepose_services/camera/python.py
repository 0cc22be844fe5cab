"""Your own camera: a Python file whose `frames()` yields one frame after the other.

    # my_camera.py
    def frames():
        while True:
            yield RgbdFrame(color, depth, camera, stamp_ns=time.monotonic_ns())

color (H, W, 3) uint8 RGB, rectified; depth (H, W) float32 metres in the pixels of colour, 0 or NaN for no
reading; stamp_ns: capture time, CLOCK_MONOTONIC, 0 for now; T_parent_cam (4, 4), for a moving camera, if
known: its pose at that time in a static frame. `frames()` may block until the next image. It may fill the
same arrays again for the next image: they are copied, in well under a millisecond.
"""

from __future__ import annotations

import runpy
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from huepose.geometry import RgbdFrame
from huepose.support.errors import InputError
from huepose_services.camera.live import CameraError, LiveSource, Shot, SourceEnded
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config

_IF_SILENT = "frames() waits for its next image: does your camera still give any?"
_RUNPY = (runpy.__file__, "<frozen runpy>")
_RAISED = (Exception, SystemExit)
"""What a file may raise: many scripts call sys.exit() if their device is not there."""


def open_source(config: Config) -> LiveSource:
    """Run the file `camera.path` once; its `frames()` is called at every opening. Raises InputError for a
    file that cannot be run, or has no `frames`."""
    assert config.camera.path is not None  # the configuration was checked
    path = Path(config.camera.path)
    if not path.is_file():
        raise InputError(path, found="no such file", expected="a Python file with a function frames()")
    try:
        names = runpy.run_path(str(path), run_name="huepose_camera")
    except _RAISED as error:
        raise InputError(path, found=_said(error, path), expected="a Python file that runs") from error
    frames = names.get("frames")
    if not callable(frames):
        raise InputError(
            path, found="no function frames()", expected="one that yields RgbdFrame after RgbdFrame"
        )
    once = config.camera.once
    return LiveSource(path.name, _IF_SILENT, lambda: PythonCamera(_opened(frames, path), path, once), once)


def _opened(frames: Callable[[], Any], path: Path) -> Iterator[Any]:
    """The iterator that `frames` of the file returns. Raises CameraError if it fails, or returns none."""
    try:
        given = frames()
    except _RAISED as error:
        raise CameraError(f"{_said(error, path)}.") from error
    if not isinstance(given, Iterable):
        raise CameraError(f"frames() returned {type(given).__name__}: it has to yield huepose.RgbdFrame")
    return iter(given)


def _said(error: BaseException, path: Path) -> str:
    """The exception, and the line of the file at path where it was raised; else the line of another
    file."""
    steps = [s for s in traceback.extract_tb(error.__traceback__) if s.filename not in (__file__, *_RUNPY)]
    where = ([step for step in steps if Path(step.filename) == path] or steps)[-1:]
    text = " ".join(str(error).split())[:200].rstrip(".")
    named = f"{type(error).__name__}: {text}" if text else type(error).__name__
    # For a syntax error there are no steps: its own text names the line.
    return "".join([named, *(f", in {Path(step.filename).name}, line {step.lineno}" for step in where)])


class PythonCamera:
    """Reads the frames of an iterator. path: its file; once: whether its end is the end of the source."""

    device_clock_is_host = True
    is_sensor = False

    def __init__(self, frames: Iterator[Any], path: Path, once: bool) -> None:
        self._frames, self._path, self._once, self._number = frames, path, once, 0

    def read(self, timeout_s: float) -> Shot | None:
        """The next image, however long it takes. Raises CameraError if `frames()` ends, fails, or yields
        anything else; SourceEnded after the last image if it is played once."""
        try:
            frame = next(self._frames)
        except StopIteration:
            if self._once:
                raise SourceEnded from None
            raise CameraError("frames() has ended. It is called again.") from None
        except _RAISED as error:
            again = "" if self._once else " frames() is called again."
            raise CameraError(f"{_said(error, self._path)}.{again}") from error
        if not isinstance(frame, RgbdFrame):
            raise CameraError(f"frames() gave {type(frame).__name__}, expected huepose.RgbdFrame")
        self._number += 1
        now = now_ns()
        # A file that fills the same array again must not change an image that is still being sent or
        # compared.
        color, depth = frame.color.copy(), frame.depth.copy()
        taken_ns, T_parent_cam = frame.stamp_ns or now, frame.T_parent_cam
        return Shot(color, depth, frame.camera, self._number, taken_ns, now, T_parent_cam=T_parent_cam)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""
