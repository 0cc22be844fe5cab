# PYTHON_ARGCOMPLETE_OK
"""Entry point of the command `huepose`. It handles Ctrl-C also while modules are imported."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading

_AGAIN_S = 0.05
"""Delay after which Ctrl-C is raised again, if it came in a callback of compiled code, which ignores it."""


def main() -> int:
    """Run the command line of this process; returns the exit code."""
    for stream in ("stdin", "stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed by who started the process, as by `2>&-`
            setattr(sys, stream, open(os.devnull, "r+"))  # noqa: SIM115  # open as long as the process
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

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else the shell ignores SIGINT
        signal.signal(signal.SIGINT, ctrl_c)
        sys.unraisablehook = lost
    try:
        from huepose_services.cli.main import main as run

        return run()
    except (KeyboardInterrupt, ImportError):  # a compiled module may turn KeyboardInterrupt into ImportError
        if not pressed:
            raise
    print("huepose: interrupted", file=sys.stderr)
    return 130
