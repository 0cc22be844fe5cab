"""What the scripts that ask for objects in boxes of others are told alike."""

from __future__ import annotations

import argparse
from pathlib import Path


def asking(description: str) -> argparse.ArgumentParser:
    """A parser that knows scenes, models, the result file, which objects to ask for and the method."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--objects", nargs="+", default=None, metavar="ID")
    parser.add_argument("--method", choices=("full", "colorpair"), default="full")
    return parser
