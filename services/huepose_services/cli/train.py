"""`huepose train`: a network learned from what code draws, without a data set. Needs the extra `train`."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path
from typing import Any

from huepose.support.files import write_text
from huepose_services.cli.options import add_from_zero, add_number, add_path, add_some_of, from_one, over_zero


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "train",
        help="train the networks that come with HuePose anew (extra: train)",
        description="Train a network on what code draws, endlessly; no data is needed. Ctrl-C ends it early "
        "and keeps what was learned.",
    )
    whats = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    _add_rotation(whats)
    _add_views(whats)


def _add_rotation(whats: Any) -> None:
    parser = whats.add_parser(
        "rotation",
        help="the turn between two frames, from matched points",
        description="Attention-DGCNN on canonical features of matched points of random objects, followed by "
        "flow as the paper's tracker follows. Leaves KIND.onnx, KIND.json, KIND.png and checkpoint.pt.",
    )
    add_some_of(
        parser,
        "--kind",
        ("residual", "direct"),
        "what is learned: what the closed form leaves over, the whole turn, or each by a network of its own "
        "(residual)",
        ["residual"],
    )
    _add_limits(parser)
    parser.set_defaults(call=train_rotation)


def _add_views(whats: Any) -> None:
    parser = whats.add_parser(
        "views",
        help="the detector's codes of views, and verification, from windows of drawn scenes",
        description="Convolutional networks by which the detector tells which view of an object is in which "
        "window, and the estimator whether a pose shows its object, learned from random objects in random "
        "scenes. Leaves views.onnx, verification.onnx, views.json, views.png and checkpoint.pt.",
    )
    _add_limits(parser)
    add_number(
        parser,
        "--room",
        6000,
        "objects that are kept to learn from, the newest, 3 MB each: 6000 take 18 GB of memory, the GPU's "
        "with --device cuda, else the computer's, more and more as they are drawn (6000)",
        kind=from_one,
    )
    parser.set_defaults(call=train_views)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    add_path(parser, "--out", "DIR", "where the network goes", required=True)
    add_number(parser, "--hours", 2.0, "wall time (2)", "H", over_zero)
    add_from_zero(parser, "--seed", "of what is drawn, and of the first weights (0)")
    add_number(parser, "--workers", 1, "processes that draw (1)", kind=from_one)
    parser.add_argument("--device", default="cpu", help="cpu or cuda (cpu)")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in DIR")


def train_rotation(arguments: argparse.Namespace) -> int:
    """Train, and say how good it became."""
    from huepose.training.rotation import RotationTraining, train

    config = RotationTraining(**_common(arguments), kinds=tuple(arguments.kind))
    for kind, report in train(config, arguments.out, arguments.resume).items():
        _told(arguments.out / f"{kind}.json", report)
    return 0


def train_views(arguments: argparse.Namespace) -> int:
    """Train, and say how good it became."""
    from huepose.training.view_codes import NAME, ViewCodeTraining, train

    config = ViewCodeTraining(**_common(arguments), room=arguments.room)
    _told(arguments.out / f"{NAME}.json", train(config, arguments.out, arguments.resume))
    return 0


def _common(arguments: argparse.Namespace) -> dict[str, Any]:
    """What both are told."""
    return {key: getattr(arguments, key) for key in ("hours", "seed", "workers", "device")}


def _told(file: Path, report: dict[str, Any]) -> None:
    """Print the report, which is also kept beside the network, with the command that made it."""
    import sys

    whole = {"command": shlex.join(["huepose", *sys.argv[1:]]), **report}
    text = json.dumps(whole, indent=2)
    print(text)
    write_text(file, text + "\n")
