"""`huepose train`: networks learned from what code draws, without a data set. Needs the extra `train`."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from huepose.geometry import Mesh


def add_parser(subparsers: Any) -> None:
    """Add the verb and what it trains."""
    parser = subparsers.add_parser(
        "train",
        help="train a detector of your objects, or the tracker's rotation network (extra: train)",
        description="Train a network on what code draws, endlessly; no data is needed. Ctrl-C ends it early "
        "and keeps what was learned.",
    )
    whats = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    _add_detector(whats)
    _add_rotation(whats)


def _add_detector(whats: Any) -> None:
    parser = whats.add_parser(
        "detector",
        help="boxes of the objects of a folder of reference models",
        description="A small network of YOLO layout, on labelled pictures of the models. Leaves "
        "detector.onnx (for detector.kind: yolo), detector.json, curve.png and checkpoint.pt.",
    )
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--bundles", type=Path, metavar="DIR", help="reference models (huepose onboard)")
    which.add_argument(
        "--builtin",
        type=int,
        nargs="+",
        metavar="SEED",
        help="the objects of the built-in scene, as printed in these",
    )
    parser.add_argument("--objects", nargs="+", metavar="NAME", help="of the folder's only these")
    parser.add_argument("--size", default="320x256", metavar="WxH", help="of the input, in pixels (320x256)")
    _add_common(parser, 1.0)
    parser.set_defaults(call=train_detector)


def _add_rotation(whats: Any) -> None:
    parser = whats.add_parser(
        "rotation",
        help="the turn between two frames, from matched points",
        description="Attention-DGCNN on canonical features of matched points of random shapes. Leaves "
        "rotation.onnx, rotation.json, curve.png and checkpoint.pt.",
    )
    parser.add_argument(
        "--kind",
        choices=("residual", "direct"),
        default="residual",
        help="what is learned: what the closed form leaves over, or the whole turn (residual)",
    )
    _add_common(parser, 2.0)
    parser.set_defaults(call=train_rotation)


def _add_common(parser: argparse.ArgumentParser, hours: float) -> None:
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the network goes")
    parser.add_argument("--hours", type=float, default=hours, metavar="H", help=f"wall time ({hours:g})")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of what is drawn, and of the first weights (0)"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes that draw (1)")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (cpu)")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in DIR")


def train_rotation(arguments: argparse.Namespace) -> int:
    """Train, and say how good it became."""
    _check(arguments)
    from huepose.training.rotation import RotationTraining, train

    config = RotationTraining(
        kind=arguments.kind,
        hours=arguments.hours,
        seed=arguments.seed,
        workers=arguments.workers,
        device=arguments.device,
    )
    _told(arguments, train(config, arguments.out, arguments.resume))
    return 0


def train_detector(arguments: argparse.Namespace) -> int:
    """The same."""
    _check(arguments)
    size = _size(arguments.size)
    from huepose.training.detector import DetectorTraining, train

    config = DetectorTraining(
        input_size=size,
        hours=arguments.hours,
        seed=arguments.seed,
        workers=arguments.workers,
        device=arguments.device,
    )
    _told(arguments, train(_things(arguments), config, arguments.out, arguments.resume))
    return 0


def _things(arguments: argparse.Namespace) -> dict[str, Sequence[Mesh]]:
    """By class the meshes that mean it."""
    if arguments.bundles is None:
        from huepose.scenes.shapes import demo_objects

        prints = [demo_objects(seed) for seed in arguments.builtin]
        return {name: [one[name] for one in prints] for name in prints[0]}
    from huepose.model import load_models

    models = load_models(arguments.bundles, arguments.objects)
    return {name: [model.mesh] for name, model in models.items()}


def _size(text: str) -> tuple[int, int]:
    """Height and width of an input."""
    from huepose.support.errors import InputError

    sides = text.split("x")
    if len(sides) != 2 or not all(side.isdigit() for side in sides):
        raise InputError("--size", found=text, expected="width and height, for example 320x256")
    return int(sides[1]), int(sides[0])


def _check(arguments: argparse.Namespace) -> None:
    from huepose.support.errors import InputError

    if not arguments.hours > 0:
        raise InputError("--hours", found=str(arguments.hours), expected="more than 0")
    if arguments.workers < 1:
        raise InputError("--workers", found=str(arguments.workers), expected="1 or more")


def _told(arguments: argparse.Namespace, report: dict[str, Any]) -> None:
    """Print the report, which is also kept beside the network, with the command that made it."""
    import sys

    whole = {"command": shlex.join(["huepose", *sys.argv[1:]]), **report}
    text = json.dumps(whole, indent=2)
    (arguments.out / f"{arguments.what}.json").write_text(text + "\n")
    print(text)
