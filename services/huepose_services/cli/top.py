"""`huepose top`: how a running pipeline is, every second."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

from huepose_services.cli.attach import add_choice, chosen

_CLEAR = "\x1b[H\x1b[J"
_EVERY_S = 1.0


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("top", help="how a running pipeline is, every second")
    parser.add_argument("--seconds", type=float, metavar="S", help="end after so long; by default never")
    add_choice(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Show until interrupted."""
    from huepose_services.cli.status_text import as_text
    from huepose_services.watch import Watch

    pipeline = chosen(arguments)
    until = float("inf") if arguments.seconds is None else time.monotonic() + arguments.seconds
    with Watch(pipeline) as watch:
        try:
            while time.monotonic() < until:
                watch.look(_EVERY_S)
                view = watch.view()
                none = f"no pipeline runs at port {pipeline.base_port}; `huepose up` starts one"
                text = as_text(view) if view.seen else none
                sys.stdout.write((_CLEAR if sys.stdout.isatty() else "") + text + "\n")
                sys.stdout.flush()
        except KeyboardInterrupt:
            pass
    return 0
