"""`huepose render-scenes`: labelled frames of heaps of objects, drawn from their meshes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from huepose.support.errors import InputError
from huepose.support.progress import progress
from huepose.support.words import counted
from huepose_services.cli.options import add_number, add_one_of, add_path


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser(
        "render-scenes",
        help="draw labelled frames to measure on",
        description="Draw heaps of objects, with varied light, noise and occlusion, as a BOP scene folder "
        "for `huepose eval estimate --bop`. The same seed gives the same frames; what is there is kept, so "
        "an interrupted run goes on where it stopped, and more frames can be added later.",
    )
    parser.add_argument(
        "--models",
        required=True,
        metavar="DIR|builtin",
        help="BOP models folder; builtin: those of the demo, whose meshes are written to OUT/models",
    )
    other = "with builtin: the same shapes in other textures, look-alikes of the demo's (0: the demo's own)"
    add_number(parser, "--textures", 0, other)
    add_one_of(
        parser,
        "--kind",
        ("heaps", "piles"),
        "piles: denser, farther away, in dim and coloured light, half of them in a box (heaps)",
    )
    add_path(parser, "--out", "DIR", "scene folder", required=True)
    add_number(parser, "--frames", 100, "how many (100)")
    add_number(parser, "--seed", 0, "of everything that varies (0)")
    parser.add_argument("--objects", type=int, nargs="+", default=None, metavar="ID", help="only these ids")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Read the meshes, draw, say what is there."""
    from huepose.datasets.bop import BopScene
    from huepose.datasets.bop_writer import write_models_folder
    from huepose.scenes.rendered import PILES, SceneRanges, write_rendered_set
    from huepose.scenes.shapes import demo_objects

    if arguments.models == "builtin":
        meshes = demo_objects(arguments.textures)
        ids = {name: k for k, name in enumerate(meshes, 1)}
        wanted = set(arguments.objects or ids.values())
        if wanted - set(ids.values()):
            raise InputError(
                "--objects", found=str(sorted(wanted)), expected=f"some of 1 to {len(ids)} with builtin"
            )
        meshes = {name: mesh for name, mesh in meshes.items() if ids[name] in wanted}
    else:
        meshes, ids = _read(Path(arguments.models), arguments.objects)
    ranges = PILES if arguments.kind == "piles" else SceneRanges()
    write_rendered_set(arguments.out, meshes, ids, arguments.frames, arguments.seed, ranges)
    if arguments.models == "builtin":
        write_models_folder(arguments.out / "models", meshes, ids)
    scene = BopScene(arguments.out)
    truths = [truth for image in scene.image_ids for truth in scene.truths(image)]
    print(
        f"{arguments.out}: {counted(len(scene.image_ids), 'frame')}, {counted(len(truths), 'label')}, "
        f"{sum(truth.visible for truth in truths)} of them visible by 30 % or more"
    )
    return 0


def _read(folder: Path, ids: list[int] | None) -> tuple[dict[str, Any], dict[str, int]]:
    from huepose.onboarding.bop_folder import bop_models
    from huepose.onboarding.meshes import read_mesh

    models = bop_models(folder, ids)
    meshes = {m.name: read_mesh(m.mesh_path, "mm") for m in progress(models, "reading meshes")}
    return meshes, {m.name: m.object_id for m in models}
