"""`huepose`: read the command line, call the command, turn errors into a paragraph and an exit code.

Each command is a module of this package with `add_parser(subparsers)`. It imports what it needs only when it
runs, so that `huepose --help` answers at once.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import io
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
# Commands that run compiled kernels in their own process.
_COMPILING = frozenset(
    {"demo", "new", "onboard", "onboard-bop", "estimate", "eval", "replay", "render-scenes", "bench"}
)
# Commands that run until they are stopped: a closed output pipe stops them, too. The others finish their work
# and write its results even if nobody reads their output any more.
_ENDLESS = frozenset({"up", "run", "view", "record", "poses", "top"})
# Commands that are too short to gain from more threads of the numeric libraries than the workers have.
_SINGLE_THREADED = frozenset({"estimate"})
# The extra that installs a package which the base installation, for subscribers, lacks.
_EXTRA_OF = {
    **dict.fromkeys(("cv2", "numba", "scipy", "onnxruntime", "PIL", "mcap", "lz4"), "edge"),
    "open3d": "onboard",
    **dict.fromkeys(("torch", "onnx", "onnxscript"), "train"),
    "rerun": "viewer",
    "cryptography": "secure",
    "rosbags": "ros2",
}
# Options that name an output file or folder.
_OUTPUTS = ("out", "json", "csv", "image", "explain", "plots", "save")
# Output options that are folders. `out` is a file or a folder, depending on the command; the rest are files.
_FOLDERS = ("explain", "plots")
# Output files whose folder must exist already, so that a mistyped folder is not made.
_FOLDER_MUST_EXIST = ("image", "save")
# Errors of a full, protected or faulty disk. Any other OSError is a defect of this program.
_DISK_ERRORS = (
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO),
    *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENAMETOOLONG),
)
DONE, BAD_INPUT, INTERRUPTED = 0, 2, 130
_MIN_SIMILARITY = 0.65  # of a mistyped word and a suggestion: 'poses' is not suggested for 'nonsense'


class _IgnoresClosedPipe:
    """A standard stream that discards what is written after its reader has closed the pipe."""

    def __init__(self, out: Any) -> None:
        self._out = out

    def __getattr__(self, name: str) -> Any:
        return getattr(self._out, name)

    def write(self, text: str) -> int:
        """Like a file's."""
        try:
            self._out.write(text)
        except BrokenPipeError:
            _discard_output(self._out)
        return len(text)

    def flush(self) -> None:
        """Like a file's."""
        try:
            self._out.flush()
        except BrokenPipeError:
            _discard_output(self._out)


class _Verbs(argparse._SubParsersAction):
    """Subparsers: the description of a command is by default its text in the list of commands."""

    def add_parser(self, name: str, **settings: Any) -> Any:
        """Like argparse's, with a description."""
        text = settings.get("help") or ""
        settings.setdefault("description", f"{text[:1].upper()}{text[1:]}." if text else None)
        return super().add_parser(name, **settings)


class _Parser(argparse.ArgumentParser):
    """Suggests the closest command, choice or option for a mistyped one."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.register("action", "parsers", _Verbs)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Like argparse's, but the command that meets an unknown option reports it, with its own usage."""
        parsed, unknown = super().parse_known_args(args, namespace)
        options = [word for word in unknown if word.startswith("--")]
        if options:
            option = options[0].split("=")[0]
            known = [known[2:] for known in self._option_string_actions if known.startswith("--")]
            closest = difflib.get_close_matches(option[2:], known, 1, _MIN_SIMILARITY)
            fix = f": did you mean '--{closest[0]}'?" if closest else ""
            self.error(f"there is no option '{option}'{fix}")
        return parsed, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            choices = map(str, action.choices or ())
            closest = difflib.get_close_matches(str(value), choices, 1, _MIN_SIMILARITY)
            if closest:
                error.message = f"there is no '{value}': did you mean '{closest[0]}'?"
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
    """Check the output paths before the work, not after it. Raises InputError."""
    for option in _OUTPUTS:
        path = getattr(parsed, option, None)
        if isinstance(path, Path):
            check_place(path, makes_folders=option not in _FOLDER_MUST_EXIST)
            if option != "out" and path.exists() and path.is_dir() != (option in _FOLDERS):
                found, wanted = ("a folder", "a file") if path.is_dir() else ("a file", "a folder")
                raise InputError(f"--{option} {path}", found=found, expected=f"{wanted}, which may be new")
            if option == "image":
                check_picture(path)


def _compiling_notice(verb: str) -> AbstractContextManager[Any]:
    """A context in which the compilation of kernels is reported, if the command may compile some."""
    if verb not in _COMPILING:
        return nullcontext()
    from huepose.support.compiling import telling_of_compiling

    return telling_of_compiling()


def _parsed(arguments: list[str] | None) -> argparse.Namespace:
    parser = build_parser()
    if "_ARGCOMPLETE" in os.environ:  # a shell asks for completions
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
    """Run a command line; returns the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        # As on stderr: a path in another encoding is printed with escapes.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        parsed = _parsed(arguments)
    except KeyboardInterrupt:
        return _interrupted("huepose")
    try:
        if parsed.verb in _SINGLE_THREADED:
            single_threaded()
        check_outputs(parsed)
        with ExitStack() as around:
            if parsed.verb not in _ENDLESS:
                around.enter_context(redirect_stdout(_IgnoresClosedPipe(sys.stdout)))
                around.enter_context(redirect_stderr(_IgnoresClosedPipe(sys.stderr)))
            around.callback(lambda: sys.stdout.flush())
            around.enter_context(_compiling_notice(parsed.verb))
            code: int = parsed.call(parsed)
        return code
    except InputError as error:
        print(f"huepose {parsed.verb}: {error}", file=sys.stderr)
        return BAD_INPUT
    except ModuleNotFoundError as error:
        if error.name not in _EXTRA_OF:
            raise
        command = install_command(_EXTRA_OF[error.name])
        print(
            f"huepose {parsed.verb}: this needs the Python package {error.name}; install it with: {command}",
            file=sys.stderr,
        )
        return BAD_INPUT
    except KeyboardInterrupt:
        return _interrupted(f"huepose {parsed.verb}")
    except BrokenPipeError:
        _discard_output(sys.stdout)  # the reader of the output has closed it
        return DONE
    except OSError as error:
        if error.errno not in _DISK_ERRORS:
            raise
        reason = error.strerror or str(error)
        if error.filename is None:  # not a file, so the output
            _discard_output(sys.stdout)
        where = error.filename or "its output"
        print(f"huepose {parsed.verb}: {where}: found {reason}.", file=sys.stderr)
        return BAD_INPUT


def _discard_output(out: Any) -> None:
    """Redirect an output to /dev/null, so that flushing its buffer does not fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())


if __name__ == "__main__":
    sys.exit(main())
