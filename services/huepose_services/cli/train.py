"""`huepose train`: networks learned from shapes made by code. Needs the extra `train`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb and what it trains."""
    parser = subparsers.add_parser(
        "train",
        help="train the tracker's rotation network (extra: train)",
        description="Train a network on an endless stream of shapes made by code; no data is needed.",
    )
    whats = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    rotation = whats.add_parser(
        "rotation",
        help="the turn between two frames, from matched points",
        description="Attention-DGCNN on canonical features of matched points. Ctrl-C ends it early and keeps "
        "what was learned. Leaves rotation.onnx, rotation.json, curve.png and checkpoint.pt.",
    )
    rotation.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the network goes")
    rotation.add_argument(
        "--kind",
        choices=("residual", "direct"),
        default="residual",
        help="what is learned: what the closed form leaves over, or the whole turn (residual)",
    )
    rotation.add_argument("--hours", type=float, default=2.0, metavar="H", help="wall time (2)")
    rotation.add_argument("--seed", type=int, default=0, metavar="N", help="of shapes and weights (0)")
    rotation.add_argument("--workers", type=int, default=1, metavar="N", help="that make shapes (1)")
    rotation.add_argument("--device", default="cpu", help="cpu or cuda (cpu)")
    rotation.add_argument("--resume", action="store_true", help="go on from the checkpoint in DIR")
    rotation.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Train, and say how good it became."""
    from huepose.support.errors import InputError

    if not arguments.hours > 0:
        raise InputError("--hours", found=str(arguments.hours), expected="more than 0")
    if arguments.workers < 1:
        raise InputError("--workers", found=str(arguments.workers), expected="1 or more")
    from huepose.training.rotation import RotationTraining, train

    config = RotationTraining(
        kind=arguments.kind,
        hours=arguments.hours,
        seed=arguments.seed,
        workers=arguments.workers,
        device=arguments.device,
    )
    print(json.dumps(train(config, arguments.out, arguments.resume), indent=2))
    return 0
