"""`huepose units`: systemd units for the workers of a pipeline.yaml."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from huepose.support.files import writing
from huepose_services.cli.options import add_host, add_path, add_pipeline


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("units", help="write systemd units for the workers of a pipeline")
    add_pipeline(parser)
    add_path(parser, "--out", "DIR", "for example /etc/systemd/system", required=True)
    parser.add_argument("--user", default="huepose", metavar="NAME", help="whose processes; default huepose")
    add_host(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Write them, and remove what an earlier pipeline had and this one has not."""
    from huepose_services.runtime.config import load_all
    from huepose_services.units import units

    configs = [config.at(arguments.host) for config in load_all(arguments.config)]
    command = (Path(sys.executable).parent / "huepose").absolute()
    files = units(configs, command, arguments.config.absolute(), arguments.user)
    with writing(arguments.out, fix="Give another with --out, or run it as root."):
        for old in arguments.out.glob("huepose@*.service.d/needs.conf"):
            if str(old.relative_to(arguments.out)) not in files:
                old.unlink()
        for name, text in files.items():
            path = arguments.out / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            print(path)
    return 0
