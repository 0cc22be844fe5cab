"""`huepose replay`: play a recording on the bus, compute its poses again, or write it as a BOP scene."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.progress import Status
from huepose_services.cli.options import (
    add_number,
    add_path,
    catch_stop_signals,
    number_of,
    print_result,
    say,
    stop_as_interrupt,
)
from huepose_services.runtime.threads import single_threaded

if TYPE_CHECKING:
    from contextlib import ExitStack

    from huepose_services.recording.read import Event, Recording
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.config import Config

_SETTLE_S = 1.0
_MOST_EARLIER_NS = 10_000_000_000
"""How much earlier than the part before it a part of a recording may begin: with frames that the tracker gave
late."""


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "replay",
        help="play a recording, compute its poses again (--verify), or write it as a BOP scene (--bop)",
        description="Publish a recording of huepose record, with its timing, on the ports of a pipeline. To "
        "let a pipeline estimate new poses in its frames, set camera.source: recording.",
    )
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="a recording, with all its parts")
    add_path(
        parser,
        "--config",
        "PIPELINE",
        "configuration for names and ports, and for the models that `huepose view` draws",
    )
    parser.add_argument(
        "--camera",
        metavar="NAME",
        help="play as this camera of PIPELINE (default: each file as the camera that it was recorded from)",
    )
    speed = number_of(float, lambda number: 0.05 <= number <= 20.0, "0.05 to 20")
    add_number(parser, "--speed", 1.0, "1: the recorded speed (default)", "X", speed)
    parser.add_argument("--loop", action="store_true", help="repeat it")
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        "--verify", action="store_true", help="compute the poses again and compare them bit by bit"
    )
    add_path(instead, "--bop", "DIR", "write a BOP scene to a new folder instead")
    add_path(parser, "--bundles", "DIR", "the reference models for --verify")
    parser.add_argument("--json", action="store_true", help="print the result of --verify as JSON")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Play until the end or until interrupted, or verify, or export."""
    # As in the tracker's worker: the result of a long sum depends on the number of threads that share it.
    single_threaded()
    from huepose_services.recording.read import Recording

    recordings = _in_order([Recording(path) for path in arguments.files])
    if arguments.verify:
        return _verify(recordings, arguments)
    if arguments.bop is not None:
        from huepose_services.recording.export import export_bop

        stop_as_interrupt()  # no part of a scene is left
        exported = export_bop(_events(recordings), arguments.bop)
        print(f"{arguments.bop}: {exported.text}")
        _say_cut(recordings)
        if not exported.frames:
            say("huepose replay: the recording has no frames (--no-frames), so no scene is written")
        return 0 if exported.frames else 1
    return _play(arguments, recordings)


def _in_order(recordings: list[Recording]) -> list[Recording]:
    """The same files, the parts of each recording in their order: shells sort run_0001.mcap before
    run.mcap."""
    parts = [_part_of(recording) for recording in recordings]
    firsts = [path for path, _ in parts]
    order = sorted(range(len(parts)), key=lambda k: (firsts.index(firsts[k]), parts[k][1]))
    return [recordings[k] for k in order]


def _part_of(recording: Recording) -> tuple[Path, int]:
    """The first file of the recording that a file is a part of, and the number of the part, from 0."""
    number, path = recording.notes.get("huepose", {}).get("part", ""), recording.path
    part = int(number) if number.isdecimal() else 0
    return path.with_name(path.name.replace(f"_{part:04d}.", ".") if part else path.name), part


def _check_one_run(recordings: list[Recording]) -> None:
    """Raises InputError for recordings of several cameras, or of which a later one began earlier: with their
    messages mixed they can be neither played nor verified."""
    from huepose_protos.keys import camera_of

    camera, began_ns = "", 0
    for k, recording in enumerate(recordings):
        if any(recording.path.samefile(other.path) for other in recordings[:k]):
            raise InputError(recording.path, found="the same file twice", expected="each part once")
        event = next(iter(recording.events()), None)
        if event is None:
            continue
        its_camera, its_ns = camera_of(event.key), event.message.publish_ns
        earlier_ns = _MOST_EARLIER_NS if _part_of(recording)[1] else 0
        if (camera and its_camera != camera) or its_ns < began_ns - earlier_ns:
            found = "a recording that began before the last one"
            if its_camera != camera:
                found = f"a recording of camera '{its_camera}'"
            raise InputError(
                recording.path,
                found=found,
                expected="the parts of one recording",
                fix="Play or verify it by itself; several cameras are played together with the --config that "
                "has them.",
            )
        camera, began_ns = its_camera, its_ns


def _events(recordings: list[Recording]) -> Iterator[Event]:
    return chain.from_iterable(recording.events() for recording in recordings)


def _say_cut(recordings: list[Recording]) -> None:
    for recording in recordings:
        if recording.cut:
            say(f"{recording.path}: {recording.cut}; what came before was read")


def _verify(recordings: list[Recording], arguments: argparse.Namespace) -> int:
    from huepose_services.recording.verify import verify

    _check_one_run(recordings)
    report = verify(recordings, arguments.bundles)
    _say_cut(recordings)
    print_result(arguments, asdict(report), report.text)
    return 0 if report.steps and not report.difference else 1


def _play(arguments: argparse.Namespace, recordings: list[Recording]) -> int:
    from contextlib import ExitStack

    from msgspec.structs import replace

    from huepose_services.recording.play import Player
    from huepose_services.runtime.clock import SECOND, now_ns
    from huepose_services.runtime.running import described, noted

    cameras = _of_cameras(arguments, recordings)
    for _, files in cameras:
        _check_one_run(files)
    names = ", ".join(f"{config.site}/{config.camera.name}" for config, _ in cameras)
    stopping = catch_stop_signals()
    with ExitStack() as stack:
        buses = [_bus(config, stack) for config, _ in cameras]
        for config, files in cameras:
            # Without workers, because none run, and so none is reported as missing.
            played = replace(described(config, arguments.config or files[0].path), workers=())
            stack.enter_context(noted(played))
        # Commands that wait for a pipeline need a moment to connect.
        time.sleep(_SETTLE_S)
        began_ns, again, status = now_ns(), True, Status()
        while again and not stopping():
            players = [
                Player(_events(files), bus, arguments.speed)
                for (_, files), bus in zip(cameras, buses, strict=True)
            ]
            left = [player for player in players if not player.finished]
            if not left:
                raise InputError(arguments.files[0], found="nothing to play", expected="messages")
            start_ns, first_ns = now_ns(), min(player.next_ns for player in left)
            for player in left:
                player.begin(start_ns, first_ns)
            while left and not stopping():
                soonest = min(left, key=Player.due_ns)
                wait_s = (soonest.due_ns() - now_ns()) / SECOND
                if wait_s > 0:
                    time.sleep(min(wait_s, 0.1))
                    continue
                soonest.play()
                status.show(f"playing as {names}: {(now_ns() - start_ns) / SECOND:.0f} s")
                if soonest.finished:
                    left.remove(soonest)
            again = arguments.loop
        time.sleep(_SETTLE_S / 4.0)
        seconds = (now_ns() - began_ns) / SECOND
        if stopping():
            status.line(f"stopped after {seconds:.1f} s")
        else:
            status.line(f"played as {names}: {seconds:.1f} s")
            _say_cut(recordings)
    return 0


def _of_cameras(
    arguments: argparse.Namespace, recordings: list[Recording]
) -> list[tuple[Config, list[Recording]]]:
    """The cameras of the configuration, each with the recordings that are played as that camera."""
    from huepose_protos.keys import camera_of
    from huepose_services.runtime.config import Config
    from huepose_services.runtime.config_file import load, load_all

    if arguments.config is None:
        return [(Config(), recordings)]
    configs = load_all(arguments.config)
    if len(configs) == 1 or arguments.camera is not None:
        return [(load(arguments.config, arguments.camera), recordings)]
    of: dict[str, list[Recording]] = {config.camera.name: [] for config in configs}
    for recording in recordings:
        event = next(iter(recording.events()), None)
        camera = "" if event is None else camera_of(event.key)
        if camera not in of:
            raise InputError(
                recording.path,
                found=f"a recording of camera '{camera}'" if camera else "no messages",
                expected=f"one of {', '.join(of)}, which {arguments.config} has",
                fix="Choose the camera to play it as: --camera NAME.",
            )
        of[camera].append(recording)
    return [(config, of[config.camera.name]) for config in configs if of[config.camera.name]]


def _bus(config: Config, stack: ExitStack) -> Bus:
    """A bus that publishes in place of a camera's workers, until the stack is left."""
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.session import open_player_session

    session = open_player_session(config)
    stack.callback(session.close)
    bus = Bus(session, config.keys, "replay")
    stack.callback(bus.close)
    token = session.liveliness().declare_token(config.keys.live("replay"))
    stack.callback(token.undeclare)
    return bus
