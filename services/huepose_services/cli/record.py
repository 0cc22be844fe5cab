"""`huepose record`: record frames and messages of a running pipeline to a file, until Ctrl-C or its end."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.progress import Status
from huepose.support.words import counted
from huepose_services.cli.options import (
    add_choice,
    add_json,
    add_number,
    add_seconds,
    catch_stop_signals,
    chosen_config,
    say,
    wait_for_pipeline,
)

if TYPE_CHECKING:
    from huepose_services.recording.parts import Parts
    from huepose_services.recording.record import Recorder


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("record", help="record a running pipeline: frames, poses, health")
    parser.add_argument("out", type=Path, metavar="FILE", help="a new file (.mcap)")
    add_choice(parser)
    add_seconds(parser, "end after this time")
    parser.add_argument("--no-frames", action="store_true", help="only messages, no images")
    parser.add_argument(
        "--jpeg",
        action="store_true",
        help="colour as JPEG: a third of the size, but not lossless (no --verify)",
    )
    add_number(parser, "--part", 2048, "start a new file at this size (2048)", "MIB")
    parser.add_argument(
        "--keep",
        type=int,
        metavar="MIB",
        help="delete the oldest files beyond this total size (default: keep all)",
    )
    add_number(parser, "--free", 1024, "end when the disk has less free space (1024)", "MIB")
    add_json(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Record until the pipeline ends, a limit is reached, or the user interrupts."""
    from huepose_services.recording.parts import SUFFIX, Limits, Parts
    from huepose_services.recording.record import Recorder, about_this_machine
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.clock import this_clock
    from huepose_services.runtime.session import open_recorder_session
    from huepose_services.runtime.worker import come_first

    part, keep, free = arguments.part, arguments.keep, arguments.free
    if part < 1 or free < 0 or (keep is not None and keep < part):
        raise InputError(
            "--part, --keep, --free",
            found=f"{part}, {'none' if keep is None else keep}, {free}",
            expected="--part 1 or more, --keep at least --part, --free 0 or more",
        )
    stopping = catch_stop_signals()
    come_first("record")
    limits = Limits(part << 20, None if keep is None else keep << 20, free << 20)
    parts = Parts(
        arguments.out, limits, this_clock().realtime_offset_ns, about_this_machine(), arguments.jpeg
    )
    if parts.path != arguments.out:
        say(f"{arguments.out} does not end in {SUFFIX}: the recording is written to {parts.path}")
    try:
        wait_for_pipeline(arguments, stopping)
        config, _ = chosen_config(arguments)
    except InputError:  # by now several pipelines run
        parts.close()
        parts.path.unlink()
        raise
    parts.note("huepose", {"site": config.site, "camera": config.camera.name})
    session = open_recorder_session(config)
    bus = Bus(session, config.keys, "record")
    recorder = Recorder(bus, parts, with_frames=not arguments.no_frames)
    status = Status()
    code, end_at = 0, float("inf")
    try:
        while not (stopping() or recorder.finished):
            recorder.step(0.1)
            status.show(_how_far(recorder, parts))
            if arguments.seconds is not None and recorder.span.first_ns is not None:
                end_at = min(end_at, time.monotonic() + arguments.seconds)
            if time.monotonic() >= end_at:
                break
        recorder.unsubscribe()
        at_once = catch_stop_signals()  # a second Ctrl-C
        while recorder.waiting and not at_once():
            recorder.step(0.0)
            status.show(f"writing what has come: {_how_far(recorder, parts)}")
    except OSError as error:
        say(f"\nhuepose record: {error.strerror or error}; what was written is kept")
        code = 1
    recorder.close()
    bus.close()
    session.close()
    try:
        parts.close()
    except OSError as error:
        say(f"\nhuepose record: {error.strerror or error}; the end is missing")
        code = 1
    if recorder.span.first_ns is None:
        say("\nhuepose record: no pipeline published anything, so nothing was recorded")
        parts.path.unlink(missing_ok=True)
        code = 1
    elif not arguments.json:
        reason = f" ({recorder.finished})" if recorder.finished else ""
        status.line(f"{_how_far(recorder, parts)}{reason}")
    if arguments.json:
        status.clear()
        print(json.dumps(_answer(recorder, parts), indent=2))
    return code


def _answer(recorder: Recorder, parts: Parts) -> dict[str, Any]:
    """What the files contain, for programs. `frames`: all frames; `frames_before`: those of the `before_s`
    seconds before the recording began, which the tracker still had. `missed`: frames that arrived but were
    not written; `lost`: frames and steps of the tracker that did not arrive even on request."""
    span = recorder.span
    return {
        "files": [str(path) for path in parts.paths if path.exists()],
        "frames": parts.frames,
        "seconds": span.seconds,
        "frames_before": span.older,
        "before_s": span.before_s,
        "bytes": parts.size if span.first_ns is not None else 0,
        "missed": recorder.missed,
        "lost": recorder.lost,
        "finished": recorder.finished,
    }


def _how_far(recorder: Recorder, parts: Parts) -> str:
    missed = f", {counted(recorder.missed, 'frame')} missed" if recorder.missed else ""
    missed += f", {recorder.lost} frames and steps of the tracker missed" if recorder.lost else ""
    span = recorder.span
    size = f"{counted(parts.frames - span.older, 'frame')}, {span.seconds:.1f} s, {parts.size / 1e6:.1f} MB"
    if span.seconds > 1.0:
        size += f" ({parts.size / 1e6 / (span.seconds + span.before_s):.0f} MB/s)"
    if span.older:
        older = counted(span.older, "older frame")
        size += f", and {older} ({span.before_s:.1f} s) that the tracker still had"
    first, *later = parts.paths  # those that --keep has not deleted
    files = f"{first} to {later[-1].name}" if later else str(first)
    return f"{files}: {size}{missed}"
