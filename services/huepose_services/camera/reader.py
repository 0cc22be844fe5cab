"""The thread that opens and reads a live camera, and keeps the newest image for the work loop.

Whatever the SDK does, the loop that takes images waits no longer than its timeout. A camera that is
missing, is unplugged, gives no more images or repeats its last image is closed; twice a second it is tried
to open it again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from huepose.support.words import rounded
from huepose_services.camera.live import CameraError, LiveCamera, LiveSource, Shot, SourceEnded
from huepose_services.convert import check_size
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.text import encodable

T = TypeVar("T")

_READ_S, _RETRY_S = 0.25, 0.5
_SILENT_NS = 2 * SECOND
_SLOW_NS = int(1.5 * SECOND)
PATIENCE_PICTURES = 3
"""A camera counts as slow or silent only after the time of this many images."""


@dataclass(frozen=True, eq=False)
class Taken:
    """An image, the number of the opening of the camera, and whether its device time is this machine's."""

    shot: Shot
    opening: int
    device_clock_is_host: bool


class Reader:
    """Starts at once, or with `start` if the source is opened only once. `take` returns the newest image,
    each only once; `trouble` says why there is none. rate_hz: the expected rate."""

    def __init__(self, source: LiveSource, rate_hz: float) -> None:
        self._source = source
        patience_ns = int(PATIENCE_PICTURES * SECOND / rate_hz)
        self._slow_ns, self._silent_ns = max(_SLOW_NS, patience_ns), max(_SILENT_NS, patience_ns)
        self._ready = threading.Condition()
        self._taken: Taken | None = None
        self._trouble: str | None = None
        self._call: tuple[str, int] | None = None
        self._news_ns: int | None = None
        self._stopping = threading.Event()
        self.openings = 0
        self.pictures = 0
        """The number of images of this opening, taken or not."""
        self.skipped = 0
        self.repeated = 0
        self.over = False
        """Whether no more image comes: all have come, or `trouble` says why it ended."""
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self.started = False
        if not source.once:
            self.start()

    def start(self) -> None:
        """Open the camera."""
        self.started = True
        self._thread.start()

    def take(self, timeout_s: float) -> Taken | None:
        """The newest image that was not taken yet; None if none comes in time."""
        with self._ready:
            if self._taken is None:
                self._ready.wait(timeout_s)
            taken, self._taken = self._taken, None
            return taken

    @property
    def trouble(self) -> str | None:
        """Why no image comes now, and what to do; None if images come."""
        call = self._call
        if call is not None and now_ns() - call[1] > self._slow_ns:
            slow = f"{call[0]} it takes longer than {rounded(self._slow_ns / SECOND)} s."
            return f"{self._source.name}: {slow} {self._source.if_silent}"
        return self._trouble

    def silent_s(self) -> float | None:
        """The time since the last new image of any opening; None before the first."""
        return None if self._news_ns is None else (now_ns() - self._news_ns) / SECOND

    def stuck_s(self) -> float:
        """The time since the SDK was called, if it has not returned; 0 if it has."""
        call = self._call
        return 0.0 if call is None else (now_ns() - call[1]) / SECOND

    def close(self) -> None:
        """Ask the thread to close the camera, and wait for it for 0.6 s at most."""
        self._stopping.set()
        if self.started:
            self._thread.join(0.6)

    def _run(self) -> None:
        while not self._stopping.is_set():
            # An SDK may raise anything, also errors that are no Exception (asyncio's CancelledError, a
            # panic of Rust), but this thread must live as long as the worker.
            try:
                camera = self._timed("opening", self._source.open)
            except BaseException as error:
                self._fail(error)
            else:
                self.openings += 1
                self.pictures = 0
                try:
                    self._read_on(camera)
                except SourceEnded:
                    self._end()
                except BaseException as error:
                    self._fail(error)
                with suppress(BaseException):  # closing an unplugged camera may fail
                    self._timed("closing", camera.close)
            self._stopping.wait(_RETRY_S)

    def _fail(self, error: BaseException) -> None:
        self._trouble = _said(self._source.name, error)
        if self._source.once:
            self._end()

    def _end(self) -> None:
        self._stopping.set()
        self.over = True

    def _timed(self, what: str, call: Callable[[], T]) -> T:
        """Call the SDK, and note the call while it lasts."""
        self._call = (what, now_ns())
        try:
            return call()
        finally:
            self._call = None

    def _read_on(self, camera: LiveCamera) -> None:
        news_ns = now_ns()
        last: Shot | None = None
        while not self._stopping.is_set():
            shot = self._timed("reading", partial(camera.read, _READ_S))
            if shot is not None:
                check_size(shot.camera)
            if shot is not None and last is not None and _is_repeated(shot, last, camera):
                # Some cameras repeat their last image for ever after they are unplugged, some with new
                # timestamps.
                self.repeated += 1
            elif shot is not None:
                last, news_ns = shot, now_ns()
                self._news_ns = news_ns
                self.pictures += 1
                self._trouble = None
                self._keep(Taken(shot, self.openings, camera.device_clock_is_host))
            if now_ns() - news_ns > self._silent_ns:
                raise CameraError(
                    f"no new image for {rounded(self._silent_ns / SECOND)} s. It is opened again; if that "
                    "does not help, use another cable or port (USB 3)."
                )

    def _keep(self, taken: Taken) -> None:
        with self._ready:
            self.skipped += self._taken is not None
            self._taken = taken
            self._ready.notify()


def _is_repeated(shot: Shot, last: Shot, camera: LiveCamera) -> bool:
    if (shot.number, shot.device_ns) == (last.number, last.device_ns):
        return True
    return camera.is_sensor and shot.shows_the_same(last)


def _said(name: str, error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return encodable(f"{name}: {text}")
