"""`huepose new`: from a mesh to a folder with everything for a first pose and a first live pipeline."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.files import check_place, write_bytes, write_picture, write_text
from huepose.support.lengths import length
from huepose_services.cli.onboard import add_symmetric, add_test
from huepose_services.cli.options import add_path, add_unit

if TYPE_CHECKING:
    from huepose.geometry import Camera
    from huepose.scenes.frame import Shot

_PIPELINE = """\
# What each key means: pipeline.yaml of the repository.
bundles: bundles
objects: [{{name: "{name}"}}]
camera:
  source: synthetic   # your object in a rendered scene; your camera: realsense or oak
  truth: true         # publish ground truth; remove this line for a real camera
"""


_FRAME = ("color.png", "depth.png", "camera.json")


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "new",
        help="start with your own object: reference model, test frame, pipeline.yaml",
        description="Make a folder with the reference model of a mesh, a rendered frame to test `huepose "
        "estimate`, and a pipeline.yaml that plays a rendered scene of the moving object.",
    )
    parser.add_argument("name", metavar="NAME", help="the object's name: 1 to 64 of a-z, 0-9, _ and -")
    parser.add_argument("mesh", type=Path, metavar="MESH", help="textured mesh (OBJ, PLY, GLB or glTF)")
    add_unit(parser)
    add_symmetric(parser)
    add_test(parser)
    add_path(parser, "--out", "DIR", "folder to write (NAME)")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Onboard the mesh, render a frame, write the folder, and print what to do next."""
    import numpy as np

    from huepose.model.io import check_name
    from huepose.onboarding.batch import Job
    from huepose.onboarding.declared import symmetries_of
    from huepose.onboarding.meshes import read_mesh
    from huepose.scenes.builtin import first_shot
    from huepose.scenes.camera import CAMERA
    from huepose_services.cli.mesh_unit import with_unit
    from huepose_services.cli.onboard import check_folder, in_words, onboard_one, self_test

    out: Path = arguments.out or Path(arguments.name)
    check_place(out)
    check_folder(out)
    path = out / "pipeline.yaml"
    for there in (path, *(out / name for name in _FRAME)):
        if there.exists():
            raise InputError(
                there,
                found="a file that exists already",
                expected="a new folder",
                fix="Choose another folder with --out DIR, or delete this file.",
            )
    check_name(arguments.name)
    symmetric = symmetries_of(arguments.symmetric)
    job = with_unit(Job(arguments.mesh, arguments.name, unit=arguments.unit, symmetric=symmetric))
    mesh = read_mesh(job.mesh_path, job.unit)
    try:  # takes a second, so it is tried before the longer work
        shot = first_shot({job.name: mesh})
    except InputError as error:
        raise InputError(
            f"no scene of {job.name} can be rendered",
            found=f"a largest side of {length(float(np.ptp(mesh.vertices, axis=0).max()))}",
            expected="an object that can move in view of a camera",
            fix="If it is smaller, give the mesh's unit (--unit mm, for example); else onboard it with "
            "`huepose onboard`, and continue with images of your camera.",
        ) from error
    print(in_words(onboard_one(job, out / "bundles", unit_known=True)))
    if arguments.test:
        _, words = self_test(out / "bundles", job.name)
        print(words)
    write_frame(out, shot, CAMERA)
    write_text(path, _PIPELINE.format(name=job.name))

    def at(name: str) -> str:
        return shlex.quote(str(out / name))

    print(
        f"""
{out} is ready. Next (the first start of a pipeline renders its scene, half a minute or more):
  huepose estimate --color {at("color.png")} --depth {at("depth.png")} --camera {at("camera.json")} \\
      --bundles {at("bundles")} --image {at("pose.png")}
  huepose demo --bundles {at("bundles")}      # the whole pipeline on it, with its accuracy
  huepose up {at("pipeline.yaml")}   # live, until Ctrl-C; in another terminal: huepose poses, huepose view"""
    )
    return 0


def write_frame(folder: Path, shot: Shot, camera: Camera) -> None:
    """Write a frame for `huepose estimate`: color.png, depth.png in tenths of a millimetre, camera.json."""
    import json

    import cv2

    from huepose.geometry.camera import whole_steps

    color, depth_file, intrinsics_file = (folder / name for name in _FRAME)
    write_picture(color, shot.color)
    depth = whole_steps(shot.depth / 1e-4)
    write_bytes(depth_file, cv2.imencode(".png", depth)[1].tobytes())
    intrinsics = {key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy", "width", "height")}
    write_text(intrinsics_file, json.dumps({**intrinsics, "depth_scale_m": 0.0001}) + "\n")
