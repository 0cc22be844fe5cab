"""Options and functions that several commands share, among them the choice of a pipeline."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from huepose.support.errors import InputError
from huepose.support.files import write_text
from huepose.support.lengths import METRES

if TYPE_CHECKING:
    from huepose_services.runtime.config import Config
    from huepose_services.runtime.running import Pipeline

N = TypeVar("N", int, float)

SAY_WAITING_AFTER_S, LOOK_EVERY_S = 3.0, 0.1
"""A command that waits says so after that long, and looks that often whether it still has to."""


def _file_or_output(name: str) -> Path | bool:
    return True if name == "-" else Path(name)


def add_json(parser: argparse.ArgumentParser, to_file: bool = False) -> None:
    """Add `--json`, the result for programs. to_file: it may name a file; then both are written."""
    if to_file:
        parser.add_argument(
            "--json",
            type=_file_or_output,
            nargs="?",
            const=True,
            metavar="FILE",
            help="print JSON instead of the summary; with FILE: write JSON to it, and print the summary",
        )
    else:
        parser.add_argument("--json", action="store_true", help="print JSON instead of the summary")


def print_result(arguments: argparse.Namespace, answer: Any, summary: str) -> None:
    """Print the summary, or the answer as JSON; if `--json` names a file, write the answer to it."""
    text = json.dumps(answer, indent=2)
    print(text if arguments.json is True else summary)
    if isinstance(arguments.json, Path):
        write_text(arguments.json, text + "\n")


def say(text: str) -> None:
    """Print a message to stderr: a program may read the result from stdout."""
    print(text, file=sys.stderr, flush=True)


def add_path(
    parser: argparse.ArgumentParser, option: str, metavar: str, text: str, *, required: bool = False
) -> None:
    """Add an option that is a file or a folder; None if it is not given."""
    parser.add_argument(option, type=Path, required=required, metavar=metavar, help=text)


class _Several(argparse.Action):
    """Each use of the option adds to the earlier ones; the first one replaces the default. A number that is
    given again counts once."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        before = getattr(namespace, self.dest)
        given = [*([] if before is self.default else before), *values]
        setattr(namespace, self.dest, [*dict.fromkeys(given)] if isinstance(given[0], int) else given)


def add_several(
    parser: argparse.ArgumentParser,
    option: str,
    metavar: str,
    text: str,
    default: Any = None,
    *,
    kind: Callable[[str], Any] = Path,
    required: bool = False,
) -> None:
    """Add a repeatable option with one or more values each time: paths, or what `kind` makes of a word."""
    parser.add_argument(
        option,
        action=_Several,
        type=kind,
        nargs="+",
        default=default,
        required=required,
        metavar=metavar,
        help=text,
    )


def add_one_of(parser: argparse.ArgumentParser, option: str, names: Sequence[str], text: str) -> None:
    """Add an option that is one of these names; the first one is the default."""
    parser.add_argument(option, choices=names, default=names[0], help=text)


def add_some_of(
    parser: argparse.ArgumentParser, option: str, names: Sequence[str], text: str, default: Sequence[str] = ()
) -> None:
    """Add an option that takes some of these names; by default those of `default`, or all."""
    parser.add_argument(
        option, action=_Several, nargs="+", choices=names, default=[*(default or names)], help=text
    )


def add_box(parser: argparse.ArgumentParser, text: str) -> None:
    """Add `--box`, four numbers in pixels."""
    parser.add_argument("--box", nargs=4, type=float, metavar=("X", "Y", "W", "H"), help=text)


def add_bundles(parser: argparse.ArgumentParser) -> None:
    """Add `--bundles`, which must be given."""
    add_path(parser, "--bundles", "DIR", "folder of reference models", required=True)


def add_number(
    parser: argparse.ArgumentParser,
    option: str,
    default: float | None,
    text: str,
    unit: str = "N",
    kind: Callable[[str], Any] | None = None,
) -> None:
    """Add an option that is a number: of the type of its default, or as `kind` (see `number_of`) allows."""
    parser.add_argument(option, type=kind or type(default), default=default, metavar=unit, help=text)


def add_from_zero(parser: argparse.ArgumentParser, option: str, text: str) -> None:
    """Add an option that is a whole number from 0, by default 0: a seed, for example."""
    parser.add_argument(option, type=from_zero, default=0, metavar="N", help=text)


def number_of(kind: Callable[[str], N], is_allowed: Callable[[N], bool], expected: str) -> Callable[[str], N]:
    """The `type` of an option that is a number within limits; expected: the limits in words."""

    def number(text: str) -> N:
        with suppress(ValueError):
            if is_allowed(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"found {text}, expected {expected}")

    return number


from_zero = number_of(int, lambda number: number >= 0, "a whole number, 0 or more")
from_one = number_of(int, lambda number: number >= 1, "a whole number, 1 or more")
over_zero = number_of(float, lambda number: number > 0.0, "more than 0")
_seconds = number_of(float, lambda seconds: seconds > 0.0, "seconds, more than 0")


def add_seconds(parser: argparse.ArgumentParser, text: str) -> None:
    """Add `--seconds`: the duration, more than 0; None if it is not given."""
    parser.add_argument("--seconds", type=_seconds, metavar="S", help=text)


def add_pipeline(parser: argparse.ArgumentParser) -> None:
    """Add the argument `config`, a pipeline.yaml."""
    parser.add_argument(
        "config",
        nargs="?",
        type=Path,
        default=Path("pipeline.yaml"),
        metavar="PIPELINE",
        help="configuration of the pipeline (pipeline.yaml in this folder)",
    )


def add_host(parser: argparse.ArgumentParser) -> None:
    """Add `--host`."""
    parser.add_argument(
        "--host",
        metavar="NAME",
        help="the computer whose workers are meant: a name of `hosts` (default: the camera's computer)",
    )


def add_profile(parser: argparse.ArgumentParser) -> None:
    """Add `--profile`."""
    text = "live: as in a pipeline; patient: may take longer (live)"
    add_one_of(parser, "--profile", ("live", "patient"), text)


def add_unit(parser: argparse.ArgumentParser) -> None:
    """Add `--unit`, of a mesh."""
    parser.add_argument(
        "--unit",
        choices=tuple(METRES),
        help="unit of the mesh; default: metres or millimetres, the more likely one by its size",
    )


def catch_stop_signals() -> Callable[[], bool]:
    """Catch Ctrl-C, SIGTERM and the end of the terminal (SIGHUP, unless nohup ignores it) from now on.

    Returns a function that says whether one of them came."""
    came = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, stop)
    return lambda: came


def stop_as_interrupt() -> None:
    """From now on SIGTERM and the end of the terminal (SIGHUP, unless nohup ignores it) act like Ctrl-C: what
    was begun is undone."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a pipeline."""
    parser.add_argument(
        "--pipeline",
        metavar="NAME",
        help="which pipeline, if several run here: its first port, or SITE/CAMERA",
    )
    add_path(parser, "--config", "PIPELINE", "or its configuration file")


def chosen(arguments: argparse.Namespace, tell: bool = True) -> Pipeline:
    """The pipeline that the options choose. tell: if they name none, and it is not the one of this folder's
    pipeline.yaml, print which one it is. Raises InputError if the choice is ambiguous."""
    from huepose_services.runtime.config_file import DEFAULT_FILE
    from huepose_services.runtime.running import pick

    pipeline = pick(arguments.config, arguments.pipeline)
    unsaid = tell and arguments.config is None and arguments.pipeline is None
    if unsaid and pipeline.file and Path(pipeline.file) != Path(DEFAULT_FILE).absolute():
        say(f"this is {pipeline.name}, which runs from {pipeline.file}")
    return pipeline


def say_if_unknown(pipeline: Pipeline) -> None:
    """If no process has noted that the pipeline runs, print where it is looked for: it may run anyway."""
    if not pipeline.noted:
        say(f"looking for a pipeline at port {pipeline.base_port} ...")


def wait_for_pipeline(
    arguments: argparse.Namespace, stopping: Callable[[], bool], until_s: float = float("inf")
) -> bool:
    """Wait until the chosen pipeline is noted or heard; if that takes long, print it. Returns whether it had
    to wait: then the choice may be another pipeline by now. until_s: time.monotonic() of the end."""
    from huepose_protos.client import Reader

    pipeline = chosen(arguments, tell=False)
    if pipeline.noted:
        return False
    say_at = time.monotonic() + SAY_WAITING_AFTER_S
    with Reader(pipeline.endpoints, pipeline.key("live/*")) as reader:
        while not (stopping() or reader.seen or time.monotonic() > until_s):
            if chosen(arguments, tell=False).noted:
                break
            if time.monotonic() > say_at:
                say_at = float("inf")
                say(f"waiting for a pipeline: {pipeline.absence}")
            time.sleep(LOOK_EVERY_S)
    return True


def chosen_config(arguments: argparse.Namespace) -> tuple[Config, bool]:
    """The configuration of the chosen pipeline, and whether its file is valid. Only names and ports if the
    file is not known, or if it has become invalid while the pipeline runs; then all workers may be in it.
    Raises InputError."""
    from msgspec.structs import replace

    from huepose_protos.local import FOLDER
    from huepose_services.runtime.config import WORKERS, BusConfig, Config
    from huepose_services.runtime.config_file import load
    from huepose_services.runtime.config_perception import CameraConfig

    pipeline = chosen(arguments)
    if pipeline.folder:
        # Its sockets may be in another folder than those of this user's own pipelines.
        os.environ[FOLDER] = pipeline.folder
    named = Config(
        site=pipeline.site,
        camera=CameraConfig(name=pipeline.camera),
        bus=BusConfig(base_port=pipeline.base_port, frame_pool_mib=pipeline.frame_pool_mib),
    )
    if not pipeline.file or pipeline.recorded:
        return named, True
    try:
        return load(Path(pipeline.file), pipeline.camera), True
    except InputError:
        if pipeline.noted:
            return replace(named, workers=WORKERS), False
        raise
