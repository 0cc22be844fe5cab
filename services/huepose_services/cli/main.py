"""`huepose`: reads the command line, calls the verb, turns errors into a paragraph and an exit code.

Each verb is a module of this package with `add_parser(subparsers)`, light to import: what a verb needs is
imported when it runs, so that `huepose --help` answers at once.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import os
import sys
from contextlib import AbstractContextManager, ExitStack, nullcontext, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any

from huepose.support.errors import InputError
from huepose.support.extras import install_command
from huepose.support.files import check_picture, check_place
from huepose_services.runtime.threads import single_threaded

# In the order in which `huepose --help` lists them.
_VERBS = (
    *("demo", "new", "onboard", "estimate", "evaluate", "render_scenes", "train", "bench", "chaos"),
    *("up", "run", "status", "graph", "objects", "poses", "view", "record", "replay", "validate"),
    *("doctor", "models", "calibrate", "units", "secure"),
)
# Those that run compiled kernels in their own process.
_COMPILING = frozenset(
    {"demo", "new", "onboard", "onboard-bop", "estimate", "eval", "replay", "render-scenes", "bench"}
)
# Those that go on until they are told to end, as by whoever closes the pipe that they print to. The others
# come to the end of their work, and write its results, when nobody reads what they print any more.
_LASTING = frozenset({"up", "run", "view", "record", "poses", "top"})
# Those whose work is too short for more threads of the numeric libraries than the workers have.
_SHORT = frozenset({"estimate"})
# What the base installation, for subscribers, does without.
_OF_EXTRAS = {
    **dict.fromkeys(("cv2", "numba", "scipy", "onnxruntime", "PIL", "mcap", "lz4"), "edge"),
    "open3d": "onboard",
    **dict.fromkeys(("torch", "onnx", "onnxscript"), "train"),
    "rerun": "viewer",
    "cryptography": "secure",
    "rosbags": "ros2",
}
# Options that say where results go.
_OUTPUTS = ("out", "json", "csv", "image", "picture", "explain", "plots", "save")
_PICTURES = ("image", "picture")
# Those that are folders. `out` is one or the other, as its verb has it; the rest are files.
_FOLDERS = ("explain", "plots")
# Those of a picture or a recording, whose folder must be there: a mistyped one is not made.
_IN_FOLDERS = ("image", "save")
# What a full, protected or odd disk answers; any other error of the system is a mistake of ours.
_OF_THE_DISK = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO),
    *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENAMETOOLONG),
)
DONE, BAD_INPUT, INTERRUPTED = 0, 2, 130
_ALIKE = 0.65  # of a word's letters, where it may be meant: 'nonsense' is no mistyped 'poses'


class _Patient:
    """An output to which what its reader does not wait for is no error: that goes nowhere."""

    def __init__(self, out: Any) -> None:
        self._out = out

    def __getattr__(self, name: str) -> Any:
        return getattr(self._out, name)

    def write(self, text: str) -> int:
        """As of a file."""
        try:
            self._out.write(text)
        except BrokenPipeError:
            _say_no_more(self._out)
        return len(text)

    def flush(self) -> None:
        """As of a file."""
        try:
            self._out.flush()
        except BrokenPipeError:
            _say_no_more(self._out)


class _Verbs(argparse._SubParsersAction):
    """Verbs whose own help begins with what the list of them says, where they have no more to say."""

    def add_parser(self, name: str, **settings: Any) -> Any:
        """As usual, with a description."""
        text = settings.get("help") or ""
        settings.setdefault("description", f"{text[:1].upper()}{text[1:]}." if text else None)
        return super().add_parser(name, **settings)


class _Parser(argparse.ArgumentParser):
    """Says of a mistyped command, choice or option which one may be meant."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.register("action", "parsers", _Verbs)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """As usual, but the command that meets an unknown option answers itself, with its own usage."""
        parsed, unknown = super().parse_known_args(args, namespace)
        options = [word for word in unknown if word.startswith("--")]
        if options:
            option = options[0].split("=")[0]
            known = [known[2:] for known in self._option_string_actions if known.startswith("--")]
            meant = difflib.get_close_matches(option[2:], known, 1, _ALIKE)
            fix = f": did you mean '--{meant[0]}'?" if meant else ""
            self.error(f"there is no option '{option}'{fix}")
        return parsed, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            meant = difflib.get_close_matches(str(value), map(str, action.choices or ()), 1, _ALIKE)
            if meant:
                error.message = f"there is no '{value}': did you mean '{meant[0]}'?"
            raise


def build_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    from huepose import __version__

    parser = _Parser(
        prog="huepose",
        description="Live 6D object poses from an RGB-D camera and textured CAD models.",
        epilog="Exit codes: 0 done, 1 the work failed, 2 wrong usage or bad input, "
        "130 ended by Ctrl-C before it was done.",
    )
    parser.add_argument("--version", action="version", version=f"huepose {__version__}")
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    for verb in _VERBS:
        import_module(f"huepose_services.cli.{verb}").add_parser(subparsers)
    return parser


def check_outputs(parsed: argparse.Namespace) -> None:
    """Look at the places that results go to before the work, not after it. Raises InputError."""
    for option in _OUTPUTS:
        path = getattr(parsed, option, None)
        if isinstance(path, Path):
            check_place(path, makes_folders=option not in _IN_FOLDERS)
            if option != "out" and path.exists() and path.is_dir() != (option in _FOLDERS):
                found, wanted = ("a folder", "a file") if path.is_dir() else ("a file", "a folder")
                raise InputError(f"--{option} {path}", found=found, expected=f"{wanted}, which may be new")
            if option in _PICTURES:
                check_picture(path)


def _told(verb: str) -> AbstractContextManager[Any]:
    """What says that kernels are compiled, around a verb that may have to."""
    if verb not in _COMPILING:
        return nullcontext()
    from huepose.support.compiling import telling_of_compiling

    return telling_of_compiling()


def _parsed(arguments: list[str] | None) -> argparse.Namespace:
    parser = build_parser()
    if "_ARGCOMPLETE" in os.environ:  # a shell asks what may come next
        import argcomplete

        argcomplete.autocomplete(parser)
    elif not (sys.argv[1:] if arguments is None else arguments):
        parser.print_help()
        parser.exit(BAD_INPUT)
    return parser.parse_args(arguments)


def _interrupted(what: str) -> int:
    print(f"{what}: interrupted", file=sys.stderr)
    return INTERRUPTED


def main(arguments: list[str] | None = None) -> int:
    """Run a command line. Returns the exit code."""
    try:
        parsed = _parsed(arguments)
    except KeyboardInterrupt:
        return _interrupted("huepose")
    try:
        if parsed.verb in _SHORT:
            single_threaded()
        check_outputs(parsed)
        with ExitStack() as around:
            if parsed.verb not in _LASTING:
                around.enter_context(redirect_stdout(_Patient(sys.stdout)))
                around.enter_context(redirect_stderr(_Patient(sys.stderr)))
            around.callback(lambda: sys.stdout.flush())
            around.enter_context(_told(parsed.verb))
            code: int = parsed.call(parsed)
        return code
    except InputError as error:
        print(f"huepose {parsed.verb}: {error}", file=sys.stderr)
        return BAD_INPUT
    except ModuleNotFoundError as error:
        if error.name not in _OF_EXTRAS:
            raise
        command = install_command(_OF_EXTRAS[error.name])
        print(
            f"huepose {parsed.verb}: this needs the Python package {error.name}; install it with: {command}",
            file=sys.stderr,
        )
        return BAD_INPUT
    except KeyboardInterrupt:
        return _interrupted(f"huepose {parsed.verb}")
    except BrokenPipeError:
        _say_no_more(sys.stdout)  # the reader of our output has left
        return DONE
    except OSError as error:
        if error.errno not in _OF_THE_DISK:
            raise
        reason = error.strerror or str(error)
        if error.filename is None:  # what writes to a file names it
            _say_no_more(sys.stdout)
        where = error.filename or "what it prints"
        print(f"huepose {parsed.verb}: {where}: found {reason}.", file=sys.stderr)
        return BAD_INPUT


def _say_no_more(out: Any) -> None:
    """An output takes nothing any more: what waits for it is not to fail again at the exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())


if __name__ == "__main__":
    sys.exit(main())
