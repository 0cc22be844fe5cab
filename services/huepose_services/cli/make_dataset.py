"""`huepose make-dataset`: stand-ins in the layouts of the official data sets, from any meshes."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.words import counted
from huepose_services.cli.options import add_number, add_path, add_several

if TYPE_CHECKING:
    from huepose.geometry import Mesh
    from huepose.scenes.official_sets import SetObject


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser(
        "make-dataset",
        help="draw a stand-in for YCB-Video or Fast-YCB",
        description="Draw frames of any meshes in the exact layout of a data set as it is downloaded, to try "
        "on it what reads the real one: BOP's YCB-V, Fast-YCB. The same seed gives the same frames.",
    )
    parser.add_argument("--format", choices=("bop-ycbv", "fast-ycb"), required=True)
    parser.add_argument(
        "--models", required=True, metavar="DIR|builtin", help="BOP models folder; builtin: those of the demo"
    )
    add_path(parser, "--out", "DIR", "folder of the data set", required=True)
    add_number(parser, "--scenes", 2, "scenes, or sequences (2)")
    add_number(parser, "--frames", 3, "in each of them; of a sequence 60 at most (3)")
    add_several(parser, "--objects", "ID", "only these ids", kind=int)
    add_number(parser, "--seed", 0, "of everything that varies (0)")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Draw, and say what is there."""
    from huepose.scenes import official_sets

    objects = _objects(arguments.models, arguments.objects)
    asked = arguments.out, objects, arguments.scenes, arguments.frames, arguments.seed
    if arguments.format == "fast-ycb":
        official_sets.write_fast_ycb_set(*asked)
        kind, count = "sequences", min(arguments.scenes, len(objects))
    else:
        official_sets.write_bop_ycbv(*asked)
        kind, count = "scenes", arguments.scenes
    print(
        f"{arguments.out}: {count} {kind} of {counted(arguments.frames, 'frame')}, "
        f"{counted(len(objects), 'object')}"
    )
    return 0


def _objects(models: str, ids: list[int] | None) -> list[SetObject]:
    import numpy as np

    from huepose.onboarding.bop_folder import bop_models
    from huepose.onboarding.meshes import read_mesh
    from huepose.scenes.official_sets import SetObject

    if models != "builtin":
        found = bop_models(Path(models), ids)
        return [
            SetObject(
                m.object_id,
                m.name,
                read_mesh(m.mesh_path, "mm"),
                np.zeros(3) if m.frame_offset_m is None else m.frame_offset_m,
                {key: value for key, value in m.info.items() if key.startswith("symmetries")},
            )
            for m in found
        ]
    # The real frames lie apart as well, by millimetres to centimetres.
    apart = np.array([0.003, -0.002, 0.008])
    return [SetObject(i, name, mesh, apart * i, {}) for i, (name, mesh) in builtin(ids).items()]


def builtin(ids: Collection[int] | None, textures: int = 0) -> dict[int, tuple[str, Mesh]]:
    """The demo's objects, or those of them that are named, by number. Raises InputError."""
    from huepose.scenes.shapes import demo_objects

    every = dict(enumerate(demo_objects(textures).items(), 1))
    wanted = every.keys() if ids is None else set(ids)
    if not wanted or wanted - every.keys():
        raise InputError("--objects", found=str(ids), expected=f"some of 1 to {len(every)} with builtin")
    return {i: every[i] for i in sorted(wanted)}
