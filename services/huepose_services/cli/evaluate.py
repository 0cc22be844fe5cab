"""`huepose eval`: accuracy on labelled data, as numbers, tables and plots."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import Any

from huepose_services.cli.options import (
    add_bundles,
    add_from_zero,
    add_number,
    add_one_of,
    add_path,
    add_profile,
    add_several,
    add_some_of,
    from_one,
    from_zero,
    number_of,
)


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("eval", help="measure accuracy on labelled data")
    verbs = parser.add_subparsers(dest="eval_verb", required=True, metavar="WHAT")
    _add_estimate(verbs)
    _add_perception(verbs)
    _add_track(verbs)
    _add_poses(verbs)
    _add_ablation(verbs)
    _add_compare(verbs)
    _add_tables(verbs)
    _add_results(verbs)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Run a subcommand: each is a module of its own, imported only now."""
    module = import_module(f"huepose_services.cli.evaluate_{arguments.eval_verb}")
    code: int = module.call(arguments)
    return code


def _common(parser: argparse.ArgumentParser) -> None:
    add_bundles(parser)
    add_path(parser, "--json", "FILE", "result file", required=True)


def _seeds(parser: argparse.ArgumentParser) -> None:
    add_several(
        parser, "--seed", "N", "seeds of the perturbed boxes; results are averaged", [0], kind=from_zero
    )


def _objects(parser: argparse.ArgumentParser) -> None:
    add_several(parser, "--objects", "ID", "only these BOP ids or names (default: all)", kind=str)


def _add_estimate(verbs: Any) -> None:
    parser = verbs.add_parser(
        "estimate",
        help="single frames",
        description="Single-frame accuracy; one row for each labelled instance of an onboarded object.",
    )
    source = parser.add_mutually_exclusive_group(required=True)
    add_several(source, "--bop", "SCENE_DIR", "scenes in BOP's layout")
    add_path(source, "--ycbv", "DIR", "YCB-Video in BOP's layout")
    _common(parser)
    add_one_of(parser, "--method", ("full", "colorpair", "paper"), "as in huepose estimate (full)")
    add_profile(parser)
    parser.add_argument(
        "--boxes",
        default="perturbed",
        metavar="perturbed|paper|gt|detect|FILE",
        help="true boxes, disturbed boxes (paper: moved by up to a tenth; perturbed: scaled as well), "
        "boxes of the detector, or boxes of a JSON file in BOP's format (perturbed)",
    )
    add_one_of(parser, "--masks", ("auto", "gt"), "gt: the true visible mask")
    _objects(parser)
    add_number(
        parser, "--min-visib", 0.1, "leave out labels with a smaller visible fraction (0.1, as in BOP)", "F"
    )
    add_path(parser, "--equivalent", "FILE", "poses that count as right like the labelled one")
    _seeds(parser)
    add_number(parser, "--threads", 2, "objects estimated at the same time (2, as in a pipeline)")
    add_path(parser, "--csv", "BOP19.csv", "poses for the BOP toolkit")
    add_path(parser, "--models-info", "FILE", "models_info.json of the data set: adds BOP's errors and AR")
    add_path(parser, "--plots", "DIR", "draw every frame")


def _add_perception(verbs: Any) -> None:
    parser = verbs.add_parser(
        "perception",
        help="boxes and masks",
        description="Whole frames, no boxes given: recall at IoU 0.5, false positives, IoU of masks.",
    )
    add_several(parser, "--bop", "SCENE_DIR", "scenes in BOP's layout", required=True)
    _common(parser)
    _objects(parser)
    add_profile(parser)
    add_some_of(parser, "--sources", ("views", "keypoints"), "sources of proposals (both)")
    add_from_zero(parser, "--seed", "seed of the perturbed boxes for masks")
    add_number(parser, "--threads", 2, "objects processed at the same time (2)")
    add_path(parser, "--plots", "DIR", "draw every frame")


def _add_track(verbs: Any) -> None:
    parser = verbs.add_parser("track", help="sequences", description="Tracking accuracy on sequences.")
    source = parser.add_mutually_exclusive_group(required=True)
    add_several(source, "--fast-ycb", "DIR", "sequences, or their folder")
    add_several(source, "--bop", "SCENE_DIR", "scenes in BOP's layout")
    _common(parser)
    add_profile(parser)
    add_one_of(parser, "--method", ("full", "paper"), "paper: the paper's tracker as it is")
    add_one_of(
        parser,
        "--rotation",
        ("direct", "residual", "kabsch"),
        "for the method paper: the rotation by a network, by the closed form with a correcting "
        "network, or by the closed form alone (direct)",
    )
    add_path(
        parser,
        "--rotation-model",
        "FILE",
        "network for --rotation, made by huepose train rotation (default: the shipped one)",
    )
    parser.add_argument(
        "--flow",
        default="dis",
        metavar="dis|FILE",
        help="for the method paper: optical flow without a network, or NeuFlow v2 from an ONNX file "
        "or a name of huepose models (dis)",
    )
    add_one_of(
        parser,
        "--protocol",
        ("free", "roft"),
        "free: only the first pose is given; roft: also poses at 5 Hz, one period late",
    )
    add_number(parser, "--every", 1, "feed and score every N-th frame (1)")
    parser.add_argument("--init", metavar="estimate|gt|FILE", help="the first pose (default: as --delayed)")
    parser.add_argument("--delayed", metavar="estimate|gt|DIR", help="the late poses of roft (estimate)")
    _objects(parser)
    _seeds(parser)
    add_path(parser, "--plots", "DIR", "draw every frame, and errors over time")


def _add_poses(verbs: Any) -> None:
    parser = verbs.add_parser(
        "poses",
        help="poses that a live run published",
        description="Score the output of `huepose poses --json` against the scene that was played. If the "
        "scene was looped, only its first pass is scored.",
    )
    parser.add_argument("poses", type=Path, metavar="POSES.jsonl", help="output of `huepose poses --json`")
    source = parser.add_mutually_exclusive_group(required=True)
    add_path(source, "--fast-ycb", "SEQ_DIR", "the sequence that was played")
    add_path(source, "--bop", "SCENE_DIR", "or the scene in BOP's layout")
    _common(parser)


def _add_ablation(verbs: Any) -> None:
    parser = verbs.add_parser(
        "ablation",
        help="optical flow filtered by colour pairs",
        description="Errors of the motion between frames some frames apart, from the whole optical flow and "
        "from the filtered one.",
    )
    add_several(parser, "--fast-ycb", "SEQ_DIR", "sequences, or their folder", required=True)
    _common(parser)
    add_path(parser, "--plots", "DIR", "folder for ablation.png")


def _add_compare(verbs: Any) -> None:
    parser = verbs.add_parser(
        "compare",
        help="compare results of two versions, row by row",
        description="Compare two result files of `huepose eval estimate`, `track`, `poses` or `perception`, "
        "or two folders with files of the same names. For each data set: which rows became right "
        "or wrong, and how much the figures changed, with a 95 % confidence interval. Exit code "
        "1 if a set became significantly worse.",
    )
    parser.add_argument("before", type=Path, metavar="BEFORE", help="a result file, or a folder of them")
    parser.add_argument("after", type=Path, metavar="AFTER", help="the same for the other version")
    add_path(parser, "--json", "FILE", "write the comparison, with all rows that became right or wrong")
    points = number_of(float, lambda number: number >= 0.0, "0 or more percentage points")
    within = "percentage points up to which a change is ignored (0.1)"
    add_number(parser, "--margin", 0.1, within, "POINTS", points)


def _add_tables(verbs: Any) -> None:
    parser = verbs.add_parser(
        "tables",
        help="the paper's tables from the official data",
        description="Make the paper's Tables I and II from YCB-Video and Fast-YCB as downloaded, with the "
        "published figures beside those of this code, as text, Markdown, CSV and one HTML page. "
        "Finished parts are kept in OUT/runs, so an interrupted command can be resumed.",
    )
    add_path(parser, "--ycbv", "DIR", "YCB-Video in BOP's layout")
    add_path(parser, "--fast-ycb", "DIR", "Fast-YCB: the folder of its sequences, or one of them")
    add_path(
        parser,
        "--unseen",
        "DIR",
        "also procedurally generated objects that nothing was fitted to: rendered into DIR once "
        "(a few minutes)",
    )
    add_path(parser, "--out", "DIR", "folder for all results", required=True)
    add_path(parser, "--bundles", "DIR", "reference models (default: made from the models folder)")
    add_path(
        parser, "--models", "DIR", "textured meshes for the reference models (the models folder of --ycbv)"
    )
    methods = "methods to compare (all three); tracking has paper and full"
    add_some_of(parser, "--methods", ("paper", "colorpair", "full"), methods)
    sample = "use only about N images spread over the scenes, and the first N frames of each sequence"
    add_number(parser, "--quick", None, sample, kind=from_one)
    parser.add_argument(
        "--boxes",
        default="paper",
        metavar="paper|perturbed|gt|FILE",
        help="paper: true boxes moved by up to a tenth, as in the paper; or a JSON file in BOP's "
        "format (paper)",
    )
    add_several(parser, "--every", "N", "feed every N-th frame (1 5)", [1, 5], kind=from_one)
    add_one_of(parser, "--protocol", ("free", "roft"), "as in eval track (free)")
    parser.add_argument(
        "--start",
        choices=("dope", "gt", "estimate"),
        help="first poses of tracks (default: DOPE's if the download has them, else the labels)",
    )
    others = "results of other methods in the format of the BOP challenge, measured as well"
    add_several(parser, "--submission", "NAME=FILE.csv", others, [], kind=str)
    add_path(
        parser, "--equivalent", "FILE", "poses that count as right like the labelled one, in separate rows"
    )
    parser.add_argument(
        "--note", metavar="TEXT", help="describes the data, if they are not the official ones"
    )
    _objects(parser)
    add_profile(parser)
    add_from_zero(parser, "--seed", "seed of the moved boxes (0)")
    add_number(parser, "--threads", 2, "objects processed at the same time (2)")


def _add_results(verbs: Any) -> None:
    parser = verbs.add_parser(
        "results",
        help="make a page from result files",
        description="Write a Markdown page from result files of `huepose eval tables`, `estimate`, `track`, "
        "`poses` or `perception`, each with its command, machine, versions and date.",
    )
    parser.add_argument("results", type=Path, nargs="+", metavar="RESULT.json", help="result files")
    add_path(parser, "--out", "FILE.md", "page to write", required=True)
    add_path(
        parser, "--readme", "FILE.md", "a document whose marked table is updated from the results as well"
    )
