"""What verbs that answer something have in common: `--json`, the answer for programs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any


def add_json(parser: argparse.ArgumentParser, to_file: bool = False) -> None:
    """Add the option; to_file: it may name a file, which is written beside the summary."""
    if to_file:
        parser.add_argument(
            "--json",
            type=Path,
            nargs="?",
            const=True,
            default=None,
            metavar="FILE",
            help="the answer as JSON: in a file, or without its name instead of the summary",
        )
    else:
        parser.add_argument("--json", action="store_true", help="the answer as JSON instead of the summary")


def answered(arguments: argparse.Namespace, answer: Any, summary: str) -> None:
    """Print the summary, or the answer as JSON; write it where a file was named."""
    text = json.dumps(answer, indent=2)
    if isinstance(arguments.json, Path):
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(text + "\n")
    print(text if arguments.json is True else summary)
