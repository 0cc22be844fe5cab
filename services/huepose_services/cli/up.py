"""`huepose up`: all workers of a pipeline, until Ctrl-C or the end of a recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from huepose_services.cli.options import add_host, until_told


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("up", help="run a whole pipeline")
    parser.add_argument("config", nargs="?", type=Path, default=Path("pipeline.yaml"), metavar="PIPELINE")
    add_host(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Run until it ends or is interrupted."""
    from huepose_services.runtime.config import load
    from huepose_services.runtime.notify import notify
    from huepose_services.runtime.prepare import prepare
    from huepose_services.runtime.reload import asked_again
    from huepose_services.runtime.running import described, noted
    from huepose_services.runtime.supervisor import Supervisor

    config = load(arguments.config).at(arguments.host)
    prepare(config)
    stopping, again = until_told(), asked_again()

    supervisor = Supervisor(config, arguments.config)
    with noted(described(config, arguments.config)):
        supervisor.start()
        try:
            told = False
            while supervisor.exit_code is None and not stopping():
                supervisor.poll()
                if again():
                    supervisor.reload()
                if supervisor.ready and not told:
                    told = True
                    notify("READY=1")
        finally:
            notify("STOPPING=1")
            supervisor.stop()
    return supervisor.exit_code or 0
