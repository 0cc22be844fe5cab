"""`huepose validate`: whether a pipeline.yaml can be started."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("validate", help="check a pipeline.yaml without starting anything")
    parser.add_argument("config", nargs="?", type=Path, default=Path("pipeline.yaml"), metavar="PIPELINE")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Read it, look for what it names, say what it is."""
    from huepose_services.runtime.config import load
    from huepose_services.runtime.prepare import check

    config = load(arguments.config)
    check(config)
    names = ", ".join(item.name for item in config.objects) or "the built-in ones"
    print(f"{arguments.config}: good")
    print(f"  workers  {', '.join(config.workers)}")
    print(f"  camera   {config.camera.name}: {config.camera.source} {config.camera.path or ''}".rstrip())
    print(f"  objects  {names}")
    print(f"  keys     huepose/{config.site}/{config.camera.name}/...")
    return 0
