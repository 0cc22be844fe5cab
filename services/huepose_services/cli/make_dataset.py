"""`huepose make-dataset`: stand-ins in the layouts of the official data sets, from any meshes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.words import counted
from huepose_services.cli.options import add_number, add_path

if TYPE_CHECKING:
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
    parser.add_argument("--objects", type=int, nargs="+", default=None, metavar="ID", help="only these ids")
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
    from huepose.scenes.shapes import demo_objects

    if models != "builtin":
        found = bop_models(Path(models), ids)
        return [
            SetObject(
                m.object_id,
                m.name,
                read_mesh(m.mesh_path, m.unit),
                np.zeros(3) if m.frame_offset_m is None else m.frame_offset_m,
                {key: value for key, value in m.info.items() if key.startswith("symmetries")},
            )
            for m in found
        ]
    # The real frames lie apart as well, by millimetres to centimetres.
    apart = np.array([0.003, -0.002, 0.008])
    objects = [
        SetObject(i, name, mesh, apart * i, {}) for i, (name, mesh) in enumerate(demo_objects().items(), 1)
    ]
    chosen = [obj for obj in objects if ids is None or obj.object_id in ids]
    if not chosen or (ids and len(chosen) != len(set(ids))):
        raise InputError("--objects", found=str(ids), expected=f"some of 1 to {len(objects)} with builtin")
    return chosen
