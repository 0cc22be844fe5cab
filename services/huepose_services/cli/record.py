"""`huepose record`: what a running pipeline sees and says, into a folder, until Ctrl-C or its end."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from huepose_services.cli.attach import add_choice, chosen_config

if TYPE_CHECKING:
    from huepose_services.recording.record import Recorder
    from huepose_services.recording.writer import SceneWriter

_NOTHING_HEARD_AFTER_S = 2.0


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("record", help="record a running pipeline: frames, poses, health")
    parser.add_argument("out", type=Path, metavar="FOLDER", help="a new folder: a BOP scene and messages")
    add_choice(parser)
    parser.add_argument("--seconds", type=float, metavar="S", help="stop after so long")
    parser.add_argument("--no-frames", action="store_true", help="messages alone")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Record until it ends or is interrupted."""
    from huepose_services.recording.record import Recorder
    from huepose_services.recording.writer import SceneWriter
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.health import Health
    from huepose_services.runtime.log import Log
    from huepose_services.runtime.session import open_reader_session

    config = chosen_config(arguments)
    stopping = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    writer = SceneWriter(arguments.out)
    session = open_reader_session([config.endpoint(worker) for worker in config.workers])
    bus = Bus(session, config.keys, "record", Log("record"), Health("record"))
    recorder = Recorder(bus, writer, with_frames=not arguments.no_frames)
    progress = _Progress(recorder, writer)
    code, say_at = 0, time.monotonic() + _NOTHING_HEARD_AFTER_S
    try:
        while not stopping and not recorder.finished:
            bus.inbox.wait(0.1)
            recorder.step()
            progress.show()
            if time.monotonic() > say_at and recorder.first_ns is None:
                say_at = float("inf")
                text = f"waiting for a pipeline at {config.endpoint('camera')}; `huepose up` starts one"
                print(text, file=sys.stderr, flush=True)
            if arguments.seconds is not None and recorder.seconds >= arguments.seconds:
                break
    except OSError as error:
        print(f"\nhuepose record: {error.strerror or error}; what was written stays", file=sys.stderr)
        code = 1
    bus.close()
    session.close()
    try:
        writer.close()
    except OSError as error:
        print(f"\nhuepose record: {error.strerror or error}; the end is missing", file=sys.stderr)
        code = 1
    progress.end()
    return code


class _Progress:
    """How much there is, in one line that is written over once a second."""

    def __init__(self, recorder: Recorder, writer: SceneWriter) -> None:
        self._recorder, self._writer = recorder, writer
        self._next = 0.0
        self._live = sys.stderr.isatty()

    def _line(self) -> str:
        r, w = self._recorder, self._writer
        missed = f", {r.missed} frames missed" if r.missed else ""
        return f"{w.folder}: {w.frames} frames, {r.seconds:.1f} s, {w.bytes / 1e6:.1f} MB{missed}"

    def show(self) -> None:
        """Draw, if it is time and anyone looks."""
        if self._live and time.monotonic() >= self._next:
            self._next = time.monotonic() + 1.0
            sys.stderr.write(f"\r{self._line()}\x1b[K")
            sys.stderr.flush()

    def end(self) -> None:
        """The last line, which stays."""
        reason = f" ({self._recorder.finished})" if self._recorder.finished else ""
        start = "\r" if self._live else ""
        print(f"{start}{self._line()}{reason}", file=sys.stderr, flush=True)
