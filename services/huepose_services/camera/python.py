"""A camera of one's own: a Python file whose `frames()` gives pictures, one after the other.

    # my_camera.py
    def frames():
        while True:
            yield RgbdFrame(color, depth, camera, stamp_ns=time.monotonic_ns())

color (H, W, 3) uint8 RGB, rectified; depth (H, W) float32 metres in the pixels of colour, 0 or NaN for no
reading; stamp_ns: when it was captured, CLOCK_MONOTONIC, 0 for now; T_parent_cam (4, 4), of a camera that
moves, if known: where it was then, in a frame that does not move. It may block as long as a picture takes.
Both arrays may be filled anew for the next picture: they are copied, in well under a millisecond.
"""

from __future__ import annotations

import runpy
import traceback
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from huepose.geometry import RgbdFrame
from huepose.support.errors import InputError
from huepose_services.camera.live import CameraError, FilmOver, LiveSource, Shot
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import Config

_IF_SILENT = "frames() waits for its next picture: does your camera still give some?"
_RUNPY = (runpy.__file__, "<frozen runpy>")
_RAISED = (Exception, SystemExit)
"""What a file may raise: many scripts call sys.exit() where their device is not there."""


def open_source(config: Config) -> LiveSource:
    """The file `camera.path`, which is run once, and its `frames()` at every opening. Raises InputError for
    one that cannot be read or has no `frames`."""
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
            path, found="no function frames()", expected="one that gives RgbdFrame after RgbdFrame"
        )
    once = config.camera.once
    return LiveSource(path.name, _IF_SILENT, lambda: PythonCamera(_opened(frames, path), path, once), once)


def _opened(frames: Callable[[], Any], path: Path) -> Iterator[Any]:
    """What `frames` of the file gives. Raises CameraError for what gives nothing."""
    try:
        given = frames()
    except _RAISED as error:
        raise CameraError(f"{_said(error, path)}.") from error
    if not isinstance(given, Iterable):
        raise CameraError(f"frames() returned {type(given).__name__}: it has to yield huepose.RgbdFrame")
    return iter(given)


def _said(error: BaseException, path: Path) -> str:
    """The exception, and where in the file at path it came up; elsewhere where it is not of that file."""
    steps = [s for s in traceback.extract_tb(error.__traceback__) if s.filename not in (__file__, *_RUNPY)]
    where = ([step for step in steps if Path(step.filename) == path] or steps)[-1:]
    text = " ".join(str(error).split())[:200].rstrip(".")
    named = f"{type(error).__name__}: {text}" if text else type(error).__name__
    # Python itself names the place of a wrong syntax.
    return "".join([named, *(f", in {Path(step.filename).name}, line {step.lineno}" for step in where)])


class PythonCamera:
    """Takes what the iterator gives; path: of the file that it is from; once: its end is the end."""

    device_clock_is_host = True
    is_sensor = False

    def __init__(self, frames: Iterator[Any], path: Path, once: bool) -> None:
        self._frames, self._path, self._once, self._number = frames, path, once, 0

    def read(self, timeout_s: float) -> Shot | None:
        """The next picture, however long it takes. Raises CameraError for none and for what is none, FilmOver
        after the last where it is played once."""
        try:
            frame = next(self._frames)
        except StopIteration:
            if self._once:
                raise FilmOver from None
            raise CameraError("frames() has ended. It is called again.") from None
        except _RAISED as error:
            again = "" if self._once else " frames() is called again."
            raise CameraError(f"{_said(error, self._path)}.{again}") from error
        if not isinstance(frame, RgbdFrame):
            raise CameraError(f"frames() gave {type(frame).__name__}, expected huepose.RgbdFrame")
        self._number += 1
        now = now_ns()
        # Whoever fills one array again and again must not change a picture that is still sent, or compared.
        color, depth = frame.color.copy(), frame.depth.copy()
        taken_ns, place = frame.stamp_ns or now, frame.T_parent_cam
        return Shot(color, depth, frame.camera, self._number, taken_ns, now, T_parent_cam=place)

    def close(self) -> None:
        """Nothing is held."""
