"""`huepose render-scenes`: labelled frames of heaps of objects, rendered from their meshes."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.progress import progress
from huepose.support.words import counted
from huepose_services.cli.options import add_from_zero, add_number, add_one_of, add_path, add_several

if TYPE_CHECKING:
    from huepose.geometry import Mesh


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "render-scenes",
        help="render labelled frames for evaluation",
        description="Render heaps of objects, with varied light, noise and occlusion, as a BOP scene folder "
        "for `huepose eval estimate --bop`. The same seed gives the same frames. Existing frames "
        "are kept, so an interrupted run can be resumed, and more frames can be added later.",
    )
    parser.add_argument(
        "--models",
        required=True,
        metavar="DIR|builtin",
        help="BOP models folder; builtin: the demo's objects, whose meshes are written to OUT/models",
    )
    other = "with builtin: other textures on the same shapes, for look-alikes (0: the demo's own)"
    add_from_zero(parser, "--textures", other)
    add_one_of(
        parser,
        "--kind",
        ("heaps", "piles"),
        "piles: denser, farther away, in dim and coloured light, half of them in a box (heaps)",
    )
    add_path(parser, "--out", "DIR", "scene folder", required=True)
    add_number(parser, "--frames", 100, "number of frames (100)")
    add_from_zero(parser, "--seed", "seed of everything that varies (0)")
    add_several(parser, "--objects", "ID", "only these object ids", kind=int)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Read the meshes, render the frames, print how many there are."""
    from huepose.datasets.bop import BopScene
    from huepose.datasets.bop_writer import write_models_folder
    from huepose.scenes.rendered import PILES, SceneRanges, write_rendered_set

    if arguments.models == "builtin":
        chosen = _builtin(arguments.objects, arguments.textures)
        meshes, ids = dict(chosen.values()), {name: i for i, (name, _) in chosen.items()}
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


def _builtin(ids: Collection[int] | None, textures: int) -> dict[int, tuple[str, Mesh]]:
    """Name and mesh of the demo's objects, or of those with these ids, by id. Raises InputError."""
    from huepose.scenes.shapes import demo_objects

    every = dict(enumerate(demo_objects(textures).items(), 1))
    wanted = every.keys() if ids is None else set(ids)
    if not wanted or wanted - every.keys():
        raise InputError("--objects", found=str(ids), expected=f"some of 1 to {len(every)} with builtin")
    return {i: every[i] for i in sorted(wanted)}


def _read(folder: Path, ids: list[int] | None) -> tuple[dict[str, Any], dict[str, int]]:
    from huepose.onboarding.bop_folder import bop_models
    from huepose.onboarding.meshes import read_mesh

    models = bop_models(folder, ids)
    meshes = {m.name: read_mesh(m.mesh_path, "mm") for m in progress(models, "reading meshes")}
    return meshes, {m.name: m.object_id for m in models}
