"""`huepose train`: train a network on generated data, without a data set. Needs the extra `train`."""

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
        help="train the networks of HuePose again (extra: train)",
        description="Train a network on generated data; no data set is needed. Ctrl-C ends it early and "
        "keeps the network.",
    )
    whats = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    _add_rotation(whats)
    _add_views(whats)


def _add_rotation(whats: Any) -> None:
    parser = whats.add_parser(
        "rotation",
        help="the rotation between two frames, from matched points",
        description="Train an Attention-DGCNN on canonical features of matched points of random objects, "
        "which optical flow tracks as in the paper's tracker. Writes KIND.onnx, KIND.json, "
        "KIND.png and checkpoint.pt.",
    )
    add_some_of(
        parser,
        "--kind",
        ("residual", "direct"),
        "what is learned: the error of the closed form, the whole rotation, or each by its own "
        "network (residual)",
        ["residual"],
    )
    _add_limits(parser)
    parser.set_defaults(call=train_rotation)


def _add_views(whats: Any) -> None:
    parser = whats.add_parser(
        "views",
        help="the detector's codes of views, and verification, from windows of rendered scenes",
        description="Train two convolutional networks on random objects in random scenes: for the detector, "
        "which view of an object is in which window; for the estimator, whether a pose shows its "
        "object. Writes views.onnx, verification.onnx, views.json, views.png and checkpoint.pt.",
    )
    _add_limits(parser)
    add_number(
        parser,
        "--room",
        6000,
        "newest objects that are kept for training, 3 MB each: 6000 take 18 GB of memory, on the "
        "GPU with --device cuda (6000)",
        kind=from_one,
    )
    parser.set_defaults(call=train_views)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    add_path(parser, "--out", "DIR", "folder for the network", required=True)
    add_number(parser, "--hours", 2.0, "wall time (2)", "H", over_zero)
    add_from_zero(parser, "--seed", "seed of the generated data and of the initial weights (0)")
    add_number(parser, "--workers", 1, "processes that generate data (1)", kind=from_one)
    parser.add_argument("--device", default="cpu", help="cpu or cuda (cpu)")
    parser.add_argument("--resume", action="store_true", help="resume from the checkpoint in DIR")


def train_rotation(arguments: argparse.Namespace) -> int:
    """Train, and print the report."""
    from huepose.training.rotation import RotationTraining, train

    config = RotationTraining(**_common(arguments), kinds=tuple(arguments.kind))
    for kind, report in train(config, arguments.out, arguments.resume).items():
        _print_and_keep(arguments.out / f"{kind}.json", report)
    return 0


def train_views(arguments: argparse.Namespace) -> int:
    """Train, and print the report."""
    from huepose.training.view_codes import NAME, ViewCodeTraining, train

    config = ViewCodeTraining(**_common(arguments), room=arguments.room)
    _print_and_keep(arguments.out / f"{NAME}.json", train(config, arguments.out, arguments.resume))
    return 0


def _common(arguments: argparse.Namespace) -> dict[str, Any]:
    """The settings that both trainings share."""
    return {key: getattr(arguments, key) for key in ("hours", "seed", "workers", "device")}


def _print_and_keep(file: Path, report: dict[str, Any]) -> None:
    """Print the report with the command that made it, and write both beside the network."""
    import sys

    whole = {"command": shlex.join(["huepose", *sys.argv[1:]]), **report}
    text = json.dumps(whole, indent=2)
    print(text)
    write_text(file, text + "\n")
