"""`huepose eval`: accuracy on labelled data, as numbers, tables and pictures."""

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
    """Run a sub-verb: each is a module of its own, imported now."""
    module = import_module(f"huepose_services.cli.evaluate_{arguments.eval_verb}")
    code: int = module.call(arguments)
    return code


def _common(parser: argparse.ArgumentParser) -> None:
    add_bundles(parser)
    add_path(parser, "--json", "FILE", "result file", required=True)


def _seeds(parser: argparse.ArgumentParser) -> None:
    add_several(parser, "--seed", "N", "of the perturbed boxes; results average", [0], kind=from_zero)


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
    add_path(source, "--ycbv", "DIR", "YCB-Video as BOP has it")
    _common(parser)
    add_one_of(parser, "--method", ("full", "colorpair", "paper"), "as in huepose estimate (full)")
    add_profile(parser)
    parser.add_argument(
        "--boxes",
        default="perturbed",
        metavar="perturbed|paper|gt|detect|FILE",
        help="true boxes, disturbed ones (paper: moved by up to a tenth; perturbed: scaled as well), those "
        "of the detector, or of a JSON file in BOP's format (perturbed)",
    )
    add_one_of(parser, "--masks", ("auto", "gt"), "gt: the true visible mask")
    _objects(parser)
    add_number(parser, "--min-visib", 0.1, "leave out labels less visible than this (0.1, as BOP does)", "F")
    add_path(parser, "--equivalent", "FILE", "poses that count as the labelled one does")
    _seeds(parser)
    add_number(parser, "--threads", 2, "objects estimated at the same time (2, as when live)")
    add_path(parser, "--csv", "BOP19.csv", "poses for the BOP toolkit")
    add_path(parser, "--models-info", "FILE", "models_info.json of the set: BOP's errors and AR as well")
    add_path(parser, "--plots", "DIR", "pictures of every frame")


def _add_perception(verbs: Any) -> None:
    parser = verbs.add_parser(
        "perception",
        help="boxes and masks",
        description="Whole frames, no boxes given: recall at IoU 0.5, false boxes, IoU of masks.",
    )
    add_several(parser, "--bop", "SCENE_DIR", "scenes in BOP's layout", required=True)
    _common(parser)
    _objects(parser)
    add_profile(parser)
    add_some_of(parser, "--sources", ("views", "keypoints"), "what proposes places (both)")
    add_from_zero(parser, "--seed", "of the perturbed boxes of masks")
    add_number(parser, "--threads", 2, "objects at the same time (2)")
    add_path(parser, "--plots", "DIR", "pictures of every frame")


def _add_track(verbs: Any) -> None:
    parser = verbs.add_parser("track", help="sequences", description="Tracking accuracy on sequences.")
    source = parser.add_mutually_exclusive_group(required=True)
    add_several(source, "--fast-ycb", "DIR", "sequences, or the folder that holds them")
    add_several(source, "--bop", "SCENE_DIR", "scenes in BOP's layout")
    _common(parser)
    add_profile(parser)
    add_one_of(parser, "--method", ("full", "paper"), "paper: the paper's tracker as it is")
    add_one_of(
        parser,
        "--rotation",
        ("direct", "residual", "kabsch"),
        "of the method paper: a network for all of the turn, one that corrects the closed form, or the "
        "closed form alone (direct)",
    )
    add_path(parser, "--rotation-model", "FILE", "its network, of huepose train rotation (the shipped one)")
    parser.add_argument(
        "--flow",
        default="dis",
        metavar="dis|FILE",
        help="of the method paper: optical flow without a network, or NeuFlow v2 from an ONNX file or "
        "a name of huepose models (dis)",
    )
    add_one_of(
        parser,
        "--protocol",
        ("free", "roft"),
        "free: started once, then alone; roft: results at 5 Hz, one period late",
    )
    add_number(parser, "--every", 1, "feed and score every N-th frame (1)")
    parser.add_argument("--init", metavar="estimate|gt|FILE", help="the first pose (default: as --delayed)")
    parser.add_argument("--delayed", metavar="estimate|gt|DIR", help="the late results of roft (estimate)")
    _objects(parser)
    _seeds(parser)
    add_path(parser, "--plots", "DIR", "pictures of every frame, and of errors over time")


def _add_poses(verbs: Any) -> None:
    parser = verbs.add_parser(
        "poses",
        help="what a live run published",
        description="Score what `huepose poses --json` printed against the scene that was played; of one "
        "that loops its first pass.",
    )
    parser.add_argument("poses", type=Path, metavar="POSES.jsonl", help="what was printed")
    source = parser.add_mutually_exclusive_group(required=True)
    add_path(source, "--fast-ycb", "SEQ_DIR", "the sequence that was played")
    add_path(source, "--bop", "SCENE_DIR", "or the scene in BOP's layout")
    _common(parser)


def _add_ablation(verbs: Any) -> None:
    parser = verbs.add_parser(
        "ablation",
        help="what colour pairs leave of flow",
        description="The raw motion between frames some frames apart, from all flow and from filtered flow.",
    )
    add_several(parser, "--fast-ycb", "SEQ_DIR", "sequences, or the folder that holds them", required=True)
    _common(parser)
    add_path(parser, "--plots", "DIR", "where ablation.png goes")


def _add_compare(verbs: Any) -> None:
    parser = verbs.add_parser(
        "compare",
        help="two states of the program, row against row",
        description="Pairs the rows of two result files of `huepose eval estimate`, `track`, `poses` or "
        "`perception`, or of two folders with files of the same names. Says of each set what was won and "
        "lost, and how much its figures changed, with a 95 % interval. Exit code 1 when a set became worse "
        "by more than its interval allows.",
    )
    parser.add_argument("before", type=Path, metavar="BEFORE", help="a result file, or a folder of them")
    parser.add_argument("after", type=Path, metavar="AFTER", help="the same of the other state")
    add_path(parser, "--json", "FILE", "the comparison with all rows that were won and lost")
    points = number_of(float, lambda number: number >= 0.0, "0 or more percentage points")
    within = "percentage points within which a change is none (0.1)"
    add_number(parser, "--margin", 0.1, within, "POINTS", points)


def _add_tables(verbs: Any) -> None:
    parser = verbs.add_parser(
        "tables",
        help="the paper's tables from the official data",
        description="The paper's Tables I and II from YCB-Video and Fast-YCB as they are downloaded, "
        "published columns beside what this code gives, as text, Markdown, CSV and one HTML page. "
        "What is done is kept in OUT/runs: an interrupted command goes on where it stopped.",
    )
    add_path(parser, "--ycbv", "DIR", "YCB-Video as BOP has it")
    add_path(parser, "--fast-ycb", "DIR", "Fast-YCB: the folder of its sequences, or one of them")
    add_path(
        parser,
        "--unseen",
        "DIR",
        "also a family of objects by code that nothing was fitted to: drawn there once (a few minutes)",
    )
    add_path(parser, "--out", "DIR", "where everything goes", required=True)
    add_path(parser, "--bundles", "DIR", "reference models; without it they are made from the models folder")
    add_path(parser, "--models", "DIR", "textured meshes to make them from (the models folder of --ycbv)")
    methods = "side by side (all three); tracking has paper and full"
    add_some_of(parser, "--methods", ("paper", "colorpair", "full"), methods)
    sample = "about N images spread over the scenes, and the first N frames of each sequence"
    parser.add_argument("--quick", type=int, metavar="N", help=sample)
    parser.add_argument(
        "--boxes",
        default="paper",
        metavar="paper|perturbed|gt|FILE",
        help="as in the paper, true boxes moved by up to a tenth; or a JSON file in BOP's format (paper)",
    )
    add_several(parser, "--every", "N", "feed every N-th frame (1 5)", [1, 5], kind=int)
    add_one_of(parser, "--protocol", ("free", "roft"), "as in eval track (free)")
    parser.add_argument(
        "--start",
        choices=("dope", "gt", "estimate"),
        help="first poses of tracks (DOPE's where the download has them, else the labels)",
    )
    others = "results of others in the form of the BOP challenge, measured beside ours"
    add_several(parser, "--submission", "NAME=FILE.csv", others, [], kind=str)
    add_path(
        parser, "--equivalent", "FILE", "poses that count as the labelled one does, in rows of their own"
    )
    parser.add_argument(
        "--note", metavar="TEXT", help="what the data are, where they are not the official ones"
    )
    _objects(parser)
    add_profile(parser)
    add_from_zero(parser, "--seed", "of the moved boxes (0)")
    add_number(parser, "--threads", 2, "objects at the same time (2)")


def _add_results(verbs: Any) -> None:
    parser = verbs.add_parser(
        "results",
        help="a page of results from their files",
        description="Writes a Markdown page of result files of `huepose eval tables`, `estimate`, `track` or "
        "`perception`, each with its command, machine, versions and date.",
    )
    parser.add_argument("results", type=Path, nargs="+", metavar="RESULT.json", help="result files")
    add_path(parser, "--out", "FILE.md", "the page", required=True)
    add_path(parser, "--readme", "FILE.md", "a document whose marked table is cut from the results as well")
