"""`huepose view`: show the images and poses of a running pipeline in a window, a browser or a file."""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose_services.cli.options import (
    add_choice,
    add_path,
    add_seconds,
    catch_stop_signals,
    chosen,
    chosen_config,
    number_of,
    say,
    wait_for_pipeline,
)
from huepose_services.runtime.threads import single_threaded

if TYPE_CHECKING:
    from huepose_services.following import Follower
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.config import Config
    from huepose_services.viewer.shapes import Body

_LONGEST_WAIT_NS = 100_000_000
_LOOK_EVERY_S, _STOPPED_AFTER_S, _FLUSH_EVERY_S = 0.1, 0.7, 1.0


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("view", help="show the images and poses of a running pipeline")
    add_choice(parser)
    where = parser.add_mutually_exclusive_group()
    port = number_of(int, lambda port: 0 < port < 65_536, "a port of 1 to 65535")
    where.add_argument(
        "--web", type=port, metavar="PORT", help="serve a page for browsers at this port; no internet needed"
    )
    add_path(where, "--save", "FILE.rrd", "write a file for the rerun viewer")
    parser.add_argument("--hypotheses", action="store_true", help="also show the tracker's other hypotheses")
    parser.add_argument(
        "--pairs",
        action="store_true",
        help="also show the colour pairs that the image confirms or contradicts",
    )
    add_seconds(parser, "end after this time")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Show until a signal or the time limit ends it."""
    _check_file(arguments.save)
    single_threaded()
    config, valid = chosen_config(arguments)
    recording = _open(arguments, config)
    stopping = catch_stop_signals()

    seconds = float("inf") if arguments.seconds is None else arguments.seconds
    if arguments.save is None:
        threading.Thread(target=_end, args=(stopping,), daemon=True).start()
    end = time.monotonic() + seconds
    if wait_for_pipeline(arguments, stopping, end):
        config, valid = chosen_config(arguments)
    pictures, failed = _run(config, valid, recording, end, stopping, arguments)
    recording.disconnect()
    if failed:
        say(f"huepose view: {arguments.save}: {failed}; what was written is kept")
        return 1
    if arguments.save is not None:
        if not pictures:
            say("huepose view: no image arrived, so nothing was saved")
            arguments.save.unlink(missing_ok=True)
            return 1
        say(f"{arguments.save}: {arguments.save.stat().st_size / 1e6:.1f} MB")
    return 0


def _check_file(path: Path | None) -> None:
    """Raises InputError for a file that exists, or that does not end in .rrd."""
    if path is None:
        return
    if path.suffix.lower() != ".rrd":
        raise InputError(
            f"--save {path}",
            found=f"the ending '{path.suffix}'",
            expected="a file for the rerun viewer, FILE.rrd",
            fix="`rerun FILE.rrd` shows it. To draw the poses of one frame, use `huepose estimate --image`.",
        )
    if path.exists():
        raise InputError(path, found="a file of that name", expected="a new one")


def _end(stopping: Callable[[], bool]) -> None:
    """End the process soon after a stop signal: a viewer that does not read blocks rerun forever."""
    while not stopping():
        time.sleep(_LOOK_EVERY_S)
    time.sleep(_STOPPED_AFTER_S)
    os._exit(0)


def _open(arguments: argparse.Namespace, config: Config) -> Any:
    import msgspec

    from huepose_services.viewer import sinks
    from huepose_services.viewer_ports import free_port

    if arguments.save is not None:
        return sinks.saved(arguments.save)
    if arguments.web is None:
        return sinks.window(config.viewer.memory_mib)
    viewer = msgspec.structs.replace(
        config.viewer,
        web_port=arguments.web,
        grpc_port=free_port(config.viewer.grpc_port, arguments.web),
    )
    recording, address = sinks.served(viewer)
    say(f"the page is {address}")
    return recording


def _run(
    config: Config,
    valid: bool,
    recording: Any,
    end: float,
    stopping: Callable[[], bool],
    arguments: argparse.Namespace,
) -> tuple[int, str]:
    """Show until a signal, the end time or a full disk; returns the number of images and an error, or ""."""
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.clock import SECOND, now_ns
    from huepose_services.runtime.session import open_reader_session
    from huepose_services.viewer import sinks
    from huepose_services.viewer.shapes import warm_up
    from huepose_services.viewer.show import Show
    from huepose_services.viewer.work import ViewerWork

    session = open_reader_session([config.endpoint(worker) for worker in config.workers])
    bus = Bus(session, config.keys, "view")
    bodies, follower = _drawn(bus, config, valid, arguments)
    warm_up()
    work = ViewerWork(
        bus,
        Show(recording, bodies),
        bodies,
        follower,
        config.viewer.image_rate_hz,
        arguments.hypotheses,
        arguments.pairs,
        begins_with_picture=arguments.save is not None,
    )
    flush_at, failed = time.monotonic(), ""
    while not (stopping() or failed) and time.monotonic() < end:
        due_ns = work.due_ns()
        wait_ns = _LONGEST_WAIT_NS if due_ns is None else min(due_ns - now_ns(), _LONGEST_WAIT_NS)
        bus.inbox.wait(wait_ns / SECOND)
        work.step()
        if arguments.save is not None and time.monotonic() > flush_at:
            flush_at, failed = time.monotonic() + _FLUSH_EVERY_S, sinks.flushed(recording)
    bus.close()
    session.close()
    return bus.health.counters.get("images", 0), failed or sinks.flushed(recording)


def _drawn(
    bus: Bus, config: Config, valid: bool, arguments: argparse.Namespace
) -> tuple[dict[str, Body], Follower[Body]]:
    """What is drawn: all objects of a pipeline whose file is known; of another one, or of a recording that
    is played, the objects in its list; none if the file, which names their folder, is not valid any more."""
    from huepose_services import models
    from huepose_services.following import Follower
    from huepose_services.recording import its_models
    from huepose_services.viewer.shapes import Body

    pipeline = chosen(arguments, tell=False)
    known = models.load(config) if valid and pipeline.file and not pipeline.recorded else {}
    bodies = {name: Body.of(model, arguments.pairs) for name, model in known.items()}

    def load(name: str) -> Body:
        if not valid:
            raise InputError(
                f"the model of {name}, which is not drawn",
                found=f"an error in {pipeline.file}, which names its folder",
                fix="`huepose validate` says what is wrong there.",
            )
        if pipeline.recorded:
            return Body.of(its_models.load_one(Path(pipeline.file), name), arguments.pairs)
        return Body.of(models.load_one(config, name), arguments.pairs)

    return bodies, Follower(bus, load, bodies)
