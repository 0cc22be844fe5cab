"""`huepose calibrate`: hand-eye calibration, the pose of the camera on the robot."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.files import write_picture
from huepose.support.words import counted
from huepose_services.cli.options import add_json, add_path, print_result

if TYPE_CHECKING:
    from huepose.geometry.arrays import Float64
    from huepose.geometry.hand_eye import HandEye
    from huepose.geometry.hand_eye_certainty import Certainty
    from huepose.geometry.hand_eye_doubts import Meaning

_COLUMNS = "frame,object,x,y,z,qx,qy,qz,qw"


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("calibrate", help="measure the camera's extrinsics on the robot")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    one = kinds.add_parser(
        "hand-eye",
        help="hand-eye calibration, from poses of the hand and of one object",
        description="Hand-eye calibration. Both files are CSV with the columns "
        f"{_COLUMNS}; rows of the same frame belong together.",
    )
    add_path(one, "--object", "FILE.csv", "T_cam_obj, as `huepose poses --csv` writes it", required=True)
    one.add_argument("--name", metavar="NAME", help="object in --object, if it has several: mug or mug/0")
    add_path(one, "--hand", "FILE.csv", "T_base_hand of the robot", required=True)
    one.add_argument(
        "--camera",
        choices=("fixed", "on-hand"),
        required=True,
        help="fixed: camera beside the robot, object in the hand; on-hand: camera on the hand, object "
        "at rest",
    )
    one.add_argument(
        "--parent", metavar="FRAME", help="name of the mount's parent frame (base_link or tool0)"
    )
    add_json(one, to_file=True)
    add_path(one, "--image", "OUT.png", "plot of the residual of each pose")
    one.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Read the poses, solve, print the mount; exit code 1 if the poses do not fit together."""
    import numpy as np

    from huepose.geometry import hand_eye, hand_eye_doubts, se3
    from huepose.geometry.hand_eye_certainty import certainty
    from huepose_services.runtime.config_perception import FRAME_NAME_IN_WORDS, is_frame_name

    if arguments.parent is not None and not is_frame_name(arguments.parent):
        raise InputError("--parent", found=repr(arguments.parent)[:80], expected=FRAME_NAME_IN_WORDS)
    seen, seen_again = _of_one_thing(arguments.object, arguments.name)
    hand, hand_again = _of_one_thing(arguments.hand, None, of_hand=True)
    frames = sorted(set(seen) & set(hand))
    if not frames:
        raise InputError(arguments.hand, found="no frame that is in both files", expected="the same frames")
    for path, again in ((arguments.object, seen_again), (arguments.hand, hand_again)):
        if unclear := sorted(again & set(frames)):
            raise InputError(
                path,
                found=f"frame {unclear[0]} in two places",
                expected="each frame once",
                fix="Numbers begin again when the camera is opened again: in both files keep only the rows "
                "since then, or only those before.",
            )
    fixed = arguments.camera == "fixed"
    hands, B = (np.array([poses[f] for f in frames]) for poses in (hand, seen))
    if np.array_equal(hands, B):
        raise InputError(arguments.hand, found="the poses of --object", expected="T_base_hand of the robot")
    if hand_eye_doubts.exchanged(hands, B):
        raise InputError(
            arguments.object,
            found="poses behind the camera, or far outside its field of view",
            expected="T_cam_obj, of an object that the camera sees",
            fix="Are the files of --object and --hand exchanged?",
        )
    A = hand_eye_doubts.measured(hands, fixed)
    found = hand_eye.solve(A, B)
    sure = certainty(A, B, found)
    parent = arguments.parent or ("base_link" if fixed else "tool0")
    mount = {
        "parent": parent,
        "translation": np.round(found.X[:3, 3], 6).tolist(),
        "quaternion": np.round(se3.quaternion_from_rotation(found.X[:3, :3]), 6).tolist(),
    }
    shift_mm, turn_deg = 1e3 * found.shift_m, np.degrees(found.turn_rad)
    shift, turn = _of(shift_mm), _of(turn_deg)
    rest = {"poses": len(frames), "shift_mm": shift, "turn_deg": turn}
    if arguments.image:
        _draw(arguments.image, frames, found)
    left = (
        f"residuals of {len(frames)} poses: median {shift['median']:.1f} mm and {turn['median']:.2f} degrees"
        f", largest {shift['largest']:.1f} mm and {turn['largest']:.2f} degrees"
    )
    if not hand_eye_doubts.fits(B, found):
        meant = hand_eye_doubts.meant(hands, B, fixed)
        words = f"THE POSES DO NOT FIT TOGETHER, so no mount is given: {left}. {_why(meant, fixed)}"
        certainty_of = {"well_determined": False, "would_fit_with": meant}
        print_result(arguments, {"mount": None, "left": rest, "certainty": certainty_of}, words)
        return 1
    apart_mm, apart_deg = 1e3 * found.forms_apart[0], float(np.degrees(found.forms_apart[1]))
    forms = (
        f"before refinement the methods of Park, Tsai and Daniilidis differ by {apart_mm:.1f} mm and "
        f"{apart_deg:.2f} degrees at most"
    )
    inner = ", ".join(f"{key}: {value}" for key, value in mount.items())
    summary = f"mount: {{{inner}}}\n{left}\n{forms}\n{_in_words(sure, len(frames), parent)}"
    if not fixed:
        summary += f"\nThe camera moves with {parent}: besides the mount, set camera.tf or camera.moving."
    facts = {
        "well_determined": sure.well,
        "shift_mm": 1e3 * sure.shift_m,
        "turn_deg": float(np.degrees(sure.turn_rad)),
        "shift_of_one_pose": sure.shift_ratio,
        "turn_of_one_pose": sure.turn_ratio,
        "least_turned_axis": sure.axis.tolist(),
        "least_turned_deg": float(np.degrees(sure.turned_rad)),
        "more_poses": sure.more,
        "closed_forms_apart_mm": apart_mm,
        "closed_forms_apart_deg": apart_deg,
    }
    print_result(arguments, {"mount": mount, "left": rest, "certainty": facts}, summary)
    return 0


def _why(meant: Sequence[Meaning], fixed: bool) -> str:
    """What makes the poses fit, in words; what to check if nothing that was tried does."""
    mounted, other = ("fixed", "on-hand") if fixed else ("on-hand", "fixed")
    fixes = {
        "millimetres": "give the positions in --hand in metres (they seem to be millimetres)",
        "object in millimetres": "give the positions in --object in metres (they seem to be millimetres)",
        "quaternion order": "give the quaternions in --hand as x y z w (they seem to be w x y z)",
        "camera": f"use --camera {other} instead of {mounted}, or invert the poses in --hand to T_base_hand",
    }
    if meant:
        return f"They fit if you {', and '.join(fixes[change] for change in meant)}"
    return (
        "Check that both files are in metres, and that --hand has quaternions as x y z w, and T_base_hand at "
        f"the same frames; that the camera is {mounted}; that the object did not move "
        f"{'in the hand' if fixed else 'at all'}, and looks the same from no other side"
    )


def _in_words(sure: Certainty, count: int, parent: str) -> str:
    """The uncertainty of the mount in words; if it exceeds that of one pose, also which poses are missing."""
    import numpy as np

    from huepose.geometry.hand_eye_certainty import WANTED_RAD

    text = (
        f"the mount may be wrong by {1e3 * sure.shift_m:.1f} mm and {np.degrees(sure.turn_rad):.2f} degrees "
        "(one standard deviation, in the worst direction)"
    )
    if sure.well:
        return text
    poor = [
        f"{what} may be {ratio:.1f} times as wrong as one pose"
        for what, ratio in (
            ("the mount's position", sure.shift_ratio),
            ("the mount's rotation", sure.turn_ratio),
        )
        if ratio > 1.0
    ]
    axis = " ".join(f"{a:.1f}" for a in sure.axis + 0.0)
    more = counted(sure.more, "pose") if sure.more else "many poses"
    least, most, wanted = np.degrees([sure.turned_rad, sure.most_rad, WANTED_RAD])
    return (
        f"{text}\n"
        f"POORLY DETERMINED: {' and '.join(poor)}. Between these {count} poses, the hand rotated by only "
        f"{least:.0f} degrees about the axis ({axis}) of {parent}, and by {most:.0f} about another. Add "
        f"{more} or more, rotated by {wanted:.0f} degrees in both directions about that axis first, then "
        "about the axes perpendicular to it"
    )


def _of_one_thing(path: Path, name: str | None, of_hand: bool = False) -> tuple[dict[int, Float64], set[int]]:
    """The poses (4, 4) in a file, by frame number, and the frames that come again after others. name: of the
    object, with or without its instance; needed if the file has several. Raises InputError, also if the file
    of the hand has poses of an object: they would fit, but give the inverse of the right mount."""
    from collections import Counter
    from itertools import groupby

    from huepose.evaluation.pose_files import read_pose_rows

    rows = read_pose_rows(path)
    if of_hand and any(row.instance is not None for row in rows):
        raise InputError(
            path,
            found="poses of an object, as `huepose poses --csv` writes them",
            expected="poses of the robot's hand in its base",
            fix="Is this the file for --object?",
        )
    counts = Counter(row.name for row in rows)
    kinds = ", ".join(f"{thing} ({count})" for thing, count in counts.items())
    if name is not None:
        rows = [row for row in rows if name in (row.name, row.object)]
        if not rows:
            raise InputError(path, found=f"no pose of {name}; poses of {kinds}", expected="one of these")
    if len({row.name for row in rows}) > 1:
        fix = (
            "Choose one with --name, or write only one of them."
            if name is None
            else "Give --name with the instance number."
        )
        raise InputError(path, found=f"poses of {kinds}", expected="poses of one thing", fix=fix)
    runs = Counter(frame for frame, _ in groupby(row.frame for row in rows))
    again = {frame for frame, count in runs.items() if count > 1}
    return {row.frame: row.T for row in rows}, again


def _of(values: Float64) -> dict[str, float]:
    import numpy as np

    return {"median": float(np.median(values)), "largest": float(values.max())}


def _draw(path: Path, frames: list[int], found: HandEye) -> None:
    import numpy as np

    from huepose.drawing.plots import line_plot

    x = np.array(frames, float)
    series = {"shift, mm": (x, 1e3 * found.shift_m), "rotation, degrees": (x, np.degrees(found.turn_rad))}
    write_picture(path, line_plot(series, "residual of each pose", "frame", "", marks=True))
