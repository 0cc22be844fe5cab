# PYTHON_ARGCOMPLETE_OK
"""The command `huepose`: the command line, whose own imports Ctrl-C may meet as well."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """Run the command line of this process. Returns the exit code."""
    pressed = False

    def ctrl_c(*what: object) -> None:
        nonlocal pressed
        pressed = True
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where a shell has it ignored
        signal.signal(signal.SIGINT, ctrl_c)
    try:
        from huepose_services.cli.main import main as run

        return run()
    except (KeyboardInterrupt, ImportError):  # a compiled module may make the one into the other
        if not pressed:
            raise
    print("huepose: interrupted", file=sys.stderr)
    return 130
