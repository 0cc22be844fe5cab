"""`huepose`: reads the command line, calls the verb, turns errors into a paragraph and an exit code.

Each verb is a module of this package with `add_parser(subparsers)`, light to import: what a verb needs is
imported when it runs, so that `huepose --help` answers at once.
"""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module

# In the order in which `huepose --help` lists them.
_VERBS = (
    *("demo", "onboard", "estimate", "evaluate", "render_scenes", "train", "bench"),
    *("up", "run", "status", "top", "graph", "objects", "poses", "view", "record", "replay", "validate"),
    *("doctor", "models", "units"),
)
# What the base installation, for subscribers, does without.
_OF_EXTRAS = {
    **dict.fromkeys(("cv2", "numba", "scipy", "onnxruntime", "open3d"), "edge"),
    **dict.fromkeys(("torch", "onnx", "onnxscript"), "train"),
    "rerun": "viewer",
}
DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def build_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    from huepose import __version__

    parser = argparse.ArgumentParser(
        prog="huepose",
        description="Live 6D object poses from an RGB-D camera and textured CAD models.",
        epilog="Exit codes: 0 done, 1 the work failed, 2 wrong usage or bad input.",
    )
    parser.add_argument("--version", action="version", version=f"huepose {__version__}")
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    for verb in _VERBS:
        import_module(f"huepose_services.cli.{verb}").add_parser(subparsers)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run a command line. Returns the exit code."""
    parsed = build_parser().parse_args(arguments)
    from huepose.support.errors import InputError

    try:
        code: int = parsed.call(parsed)
        return code
    except InputError as error:
        print(f"huepose {parsed.verb}: {error}", file=sys.stderr)
        return BAD_INPUT
    except ModuleNotFoundError as error:
        if error.name not in _OF_EXTRAS:
            raise
        print(
            f"huepose {parsed.verb}: this needs the Python package {error.name}; "
            f"install it with: pip install 'huepose[{_OF_EXTRAS[error.name]}]'.",
            file=sys.stderr,
        )
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"huepose {parsed.verb}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of our output has left: nothing more to say, and nothing to flush at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE


if __name__ == "__main__":
    sys.exit(main())
