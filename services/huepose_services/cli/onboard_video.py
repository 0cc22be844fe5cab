"""`huepose onboard --from-video`: make a mesh from a recording of an object."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.files import check_place
from huepose.support.progress import progress
from huepose_services.cli.options import add_box, add_path

if TYPE_CHECKING:
    from huepose.datasets.types import Scene
    from huepose.geometry import RgbdFrame
    from huepose.onboarding.from_video import Learned, Selection

ALL_ROUND = 0.6
"""Least share of the surface in a recording from all sides. An object on a table shows four fifths of it."""


@dataclass(frozen=True)
class FromVideo:
    """A mesh from a recording. mesh: the file that was written; words: its quality in words; facts: the same
    for programs, with the share of the surface that was seen, and whether it was seen from all sides."""

    mesh: Path
    words: str
    facts: dict[str, Any]


def add_video(parser: argparse.ArgumentParser) -> None:
    """Add the options of a recording that replaces a mesh."""
    add_path(
        parser,
        "--from-video",
        "RECORDING",
        "instead of a mesh: a recording of `huepose record` (.mcap), a ROS bag (.bag, .db3, "
        ".mcap or its folder) or a BOP scene's folder, in which the object turns in the hand or "
        "on a turntable; needs --box or --click",
    )
    add_box(parser, "box of the object in the first frame of the recording, pixels")
    parser.add_argument(
        "--click",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="or one pixel of the object, if it touches only the ground",
    )


def mesh_from_video(arguments: argparse.Namespace) -> FromVideo | None:
    """The mesh of a recording, written to OUT/NAME_mesh; None if a mesh is given. Raises InputError for both
    or neither."""
    video: Path | None = arguments.from_video
    if (video is None) == (arguments.mesh is None):
        raise InputError(
            "the object",
            found="neither MESH nor --from-video" if video is None else "MESH and --from-video",
            expected="one of them",
        )
    if video is None:
        return None
    if (arguments.box is None) == (arguments.click is None):
        raise InputError(
            "--from-video",
            found="both --box and --click" if arguments.box else "neither --box nor --click",
            expected="one of them, on the object in the first frame",
        )
    if arguments.unit is not None:
        raise InputError(
            "--from-video",
            found=f"--unit {arguments.unit}",
            expected="no unit: it is for a mesh; a recording has depth in metres",
            fix="Leave --unit out.",
        )
    from huepose.datasets.bop_writer import write_obj
    from huepose.geometry import Box
    from huepose.model.io import check_name
    from huepose.onboarding.from_video import Selection

    check_name(arguments.name)
    path = Path(arguments.out) / f"{arguments.name}_mesh" / f"{arguments.name}.obj"
    check_place(path)
    selection = Selection(Box(*arguments.box)) if arguments.box else Selection(click=tuple(arguments.click))
    made = _learned(_scene(video), selection, arguments.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_obj(path, made.mesh)
    facts = {
        "mesh": str(path),
        "frames": made.frames,
        "followed": len(made.T_cam_obj),
        "views": made.views,
        "directions": made.directions,
        "surface": made.surface,
        "all_round": made.surface >= ALL_ROUND,
        "closing_m": made.closing_m,
    }
    return FromVideo(path, _in_words(made, path), facts)


def _scene(path: Path) -> Scene:
    if _is_bag(path):
        from huepose.datasets.rosbag import RosbagScene

        return RosbagScene(path)
    if path.suffix == ".mcap":
        from huepose_services.camera.recording import RecordedScene

        return RecordedScene(path)
    if path.is_file():
        from huepose.datasets.files import instead_of_film

        raise InputError(
            path,
            found="a file of another kind",
            expected="a recording of `huepose record` (.mcap), a ROS bag (.bag, .db3 or .mcap, or its "
            "folder), or the folder of a BOP scene",
            fix=instead_of_film(path),
        )
    from huepose.datasets.bop import BopScene

    return BopScene(path)


def _is_bag(path: Path) -> bool:
    """Whether a path is a ROS bag, as a file or as a folder."""
    if path.suffix == ".mcap":
        from huepose_services.recording.read import is_of_ros

        return is_of_ros(path)
    return path.suffix in (".bag", ".db3") or (path / "metadata.yaml").is_file()


def _learned(scene: Scene, selection: Selection, name: str) -> Learned:
    from huepose.onboarding.from_video import learn

    def frames() -> Iterator[RgbdFrame]:
        for image in progress(scene.image_ids, f"following {name}"):
            yield scene.frame(image)

    return learn(frames(), selection, lambda stage: print(stage, file=sys.stderr, flush=True))


def _in_words(made: Learned, path: Path) -> str:
    closing = "no full turn was closed"
    if made.closing_m is not None:
        apart = f"{1000 * made.closing_m:.1f} mm apart"
        closing = f"start and end of a full turn were {apart} before they were joined"
    words = (
        f"from the recording: tracked in {len(made.T_cam_obj)} of {made.frames} frames, {made.views} views "
        f"from {100 * made.directions:.0f} % of all directions; {closing}\n"
        f"{100 * made.surface:.0f} % of the surface was seen; the rest of the mesh is a guess\n"
        f"{path}: metres, origin in the middle, z up from the ground"
    )
    if made.surface < ALL_ROUND:
        words += (
            "\nNOT ALL ROUND (exit code 1): it will not be found from the sides that were not seen. Record "
            "it from all sides: turn it all round, and tip it over in between"
        )
    return words
