"""Options and habits that several verbs share, among them which pipeline is meant."""

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

_SAY_WAITING_AFTER_S, _LOOK_EVERY_S = 3.0, 0.1


def _file_or_output(name: str) -> Path | bool:
    return True if name == "-" else Path(name)


def add_json(parser: argparse.ArgumentParser, to_file: bool = False) -> None:
    """Add `--json`, the answer for programs; to_file: it may name a file, which is written beside the
    summary."""
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


def answered(arguments: argparse.Namespace, answer: Any, summary: str) -> None:
    """Print the summary, or the answer as JSON; write it where a file was named."""
    text = json.dumps(answer, indent=2)
    print(text if arguments.json is True else summary)
    if isinstance(arguments.json, Path):
        write_text(arguments.json, text + "\n")


def say(text: str) -> None:
    """Tell the user something beside the answer, which a program may read from standard output."""
    print(text, file=sys.stderr, flush=True)


def add_path(
    parser: argparse.ArgumentParser, option: str, metavar: str, text: str, *, required: bool = False
) -> None:
    """Add an option that is a file or a folder, None where it may be left out and is."""
    parser.add_argument(option, type=Path, required=required, metavar=metavar, help=text)


class _Several(argparse.Action):
    """Each use of the option adds to what those before gave; the first one takes the place of the default."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        before = getattr(namespace, self.dest)
        setattr(namespace, self.dest, [*([] if before is self.default else before), *values])


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
    """Add an option that takes one or more files or folders, or what `kind` makes of a word; given again it
    adds to them."""
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
    """Add an option that is one of some names, the first of them by default."""
    parser.add_argument(option, choices=names, default=names[0], help=text)


def add_some_of(
    parser: argparse.ArgumentParser, option: str, names: Sequence[str], text: str, default: Sequence[str] = ()
) -> None:
    """Add an option that takes some of these names, all of them by default."""
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
    """Add an option that is a number of the type of its default, or what `kind` (see `number_of`) allows."""
    parser.add_argument(option, type=kind or type(default), default=default, metavar=unit, help=text)


def add_from_zero(parser: argparse.ArgumentParser, option: str, text: str) -> None:
    """Add an option that is a whole number, 0 or more, and 0 by default: a seed, for example."""
    parser.add_argument(option, type=from_zero, default=0, metavar="N", help=text)


def number_of(kind: Callable[[str], N], is_allowed: Callable[[N], bool], expected: str) -> Callable[[str], N]:
    """The `type` of an option that is a number within limits; expected: these in words."""

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
    """Add `--seconds`: after how many to end, more than 0; None where it is not given."""
    parser.add_argument("--seconds", type=_seconds, metavar="S", help=text)


def add_pipeline(parser: argparse.ArgumentParser) -> None:
    """Add the file that describes a deployment, as `config`."""
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


def until_told() -> Callable[[], bool]:
    """From now on Ctrl-C, SIGTERM and the end of the terminal (SIGHUP, unless nohup has it ignored) end
    nothing by themselves: the answer is whether one of them came."""
    told = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal told
        told = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, stop)
    return lambda: told


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose a pipeline."""
    parser.add_argument(
        "--pipeline",
        metavar="NAME",
        help="which pipeline, if several run here: its first port, or SITE/CAMERA",
    )
    add_path(parser, "--config", "PIPELINE", "or its configuration file")


def chosen(arguments: argparse.Namespace, tell: bool = True) -> Pipeline:
    """The pipeline that is meant. tell: say which it is where nobody named one, and it is not that of this
    folder. Raises InputError where it is not clear."""
    from huepose_services.runtime.config import DEFAULT_FILE
    from huepose_services.runtime.running import pick

    pipeline = pick(arguments.config, arguments.pipeline)
    unsaid = tell and arguments.config is None and arguments.pipeline is None
    if unsaid and pipeline.file and Path(pipeline.file) != Path(DEFAULT_FILE).absolute():
        say(f"this is {pipeline.name}, which runs from {pipeline.file}")
    return pipeline


def say_if_unknown(pipeline: Pipeline) -> None:
    """Say what is waited for where nobody has noted that the pipeline runs: it may all the same."""
    if not pipeline.noted:
        say(f"looking for a pipeline at port {pipeline.base_port} ...")


def awaited(
    arguments: argparse.Namespace, stopping: Callable[[], bool], until_s: float = float("inf")
) -> bool:
    """Waits until the pipeline that is meant is noted or heard, and says so; it may be another one by then.
    until_s: time.monotonic(), at most. Whether it was not there at once."""
    from huepose_protos.client import Reader

    pipeline = chosen(arguments, tell=False)
    if pipeline.noted:
        return False
    say_at = time.monotonic() + _SAY_WAITING_AFTER_S
    with Reader(pipeline.endpoints) as reader:
        while not (stopping() or reader.seen or time.monotonic() > until_s):
            if chosen(arguments, tell=False).noted:
                break
            if time.monotonic() > say_at:
                say_at = float("inf")
                say(f"waiting for a pipeline: {pipeline.absence}")
            time.sleep(_LOOK_EVERY_S)
    return True


def chosen_config(arguments: argparse.Namespace, names_do: bool = False) -> Config:
    """The configuration of the pipeline that is meant; names and ports alone where its file is not known.
    names_do: also where the file of one that runs is wrong by now. Raises InputError."""
    from msgspec.structs import replace

    from huepose_protos.local import FOLDER
    from huepose_services.runtime.config import WORKERS, BusConfig, Config, load
    from huepose_services.runtime.config_perception import CameraConfig

    pipeline = chosen(arguments)
    if pipeline.folder:
        # Its sockets may be in another folder than those that this user's own pipelines would have.
        os.environ[FOLDER] = pipeline.folder
    named = Config(
        site=pipeline.site,
        camera=CameraConfig(name=pipeline.camera),
        bus=BusConfig(base_port=pipeline.base_port, frame_pool_mib=pipeline.frame_pool_mib),
    )
    if not pipeline.file or pipeline.recorded:
        return named
    try:
        return load(Path(pipeline.file), pipeline.camera)
    except InputError:
        if names_do and pipeline.noted:
            return replace(named, workers=WORKERS)
        raise
