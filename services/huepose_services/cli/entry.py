# PYTHON_ARGCOMPLETE_OK
"""The command `huepose`: the command line, whose own imports Ctrl-C may meet as well."""

from __future__ import annotations

import _thread
import signal
import sys
import threading

_AGAIN_S = 0.05
"""After this time Ctrl-C is tried again where it met a callback of compiled code, which cannot end by it."""


def main() -> int:
    """Run the command line of this process. Returns the exit code."""
    pressed = False

    def ctrl_c(*what: object) -> None:
        nonlocal pressed
        pressed = True
        raise KeyboardInterrupt

    def lost(what: sys.UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(what)
            return
        again = threading.Timer(_AGAIN_S, _thread.interrupt_main)
        again.daemon = True
        again.start()

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where a shell has it ignored
        signal.signal(signal.SIGINT, ctrl_c)
        sys.unraisablehook = lost
    try:
        from huepose_services.cli.main import main as run

        return run()
    except (KeyboardInterrupt, ImportError):  # a compiled module may make the one into the other
        if not pressed:
            raise
    print("huepose: interrupted", file=sys.stderr)
    return 130
