"""`huepose demo`: run the pipeline on the built-in scene; print accuracy and latency at the end."""

from __future__ import annotations

import argparse
from typing import Any

from huepose.support.errors import InputError
from huepose_services.cli.options import (
    add_from_zero,
    add_json,
    add_number,
    add_one_of,
    add_path,
    add_several,
    number_of,
    print_result,
    say,
)


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "demo", help="run the whole pipeline on a built-in scene and measure its accuracy"
    )
    seconds = number_of(float, lambda number: number >= 5.0, "5 or more")
    add_number(parser, "--seconds", 25.0, "duration (default: 25)", "S", seconds)
    add_from_zero(parser, "--seed", "number of the scene (default: 0)")
    add_path(
        parser,
        "--bundles",
        "DIR",
        "a scene of your own objects: folder of reference models (default: built-in objects)",
    )
    only = "only these objects (about five fit side by side)"
    add_several(parser, "--object", "NAME", only, [], kind=str)
    add_one_of(
        parser,
        "--segmenter",
        ("depth", "sam"),
        "how objects are segmented: by depth and colour, or by networks (depth)",
    )
    parser.add_argument(
        "--sam",
        nargs=2,
        metavar=("ENCODER", "DECODER"),
        help="networks of the segmenter sam: ONNX files, or names of `huepose models` "
        "(nanosam-encoder nanosam-decoder)",
    )
    parser.add_argument("--headless", action="store_true", help="no live table")
    add_json(parser, to_file=True)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Run the demo, print the report; exit code 1 if the figures fall short."""
    import os

    if arguments.sam is not None and arguments.segmenter != "sam":
        raise InputError("--sam", found=f"--segmenter {arguments.segmenter}", expected="--segmenter sam")
    from huepose_services.demo.run import DemoError, pipeline, run_demo
    from huepose_services.demo.score import shortcomings
    from huepose_services.demo.table import report

    try:
        scene = (arguments.seed, arguments.bundles, arguments.object)
        chosen = pipeline(*scene, arguments.segmenter, arguments.sam or ())
        live = not arguments.headless and arguments.json is not True
        result = run_demo(chosen, arguments.seconds, live)
    except DemoError as error:
        say(f"huepose demo: {error}")
        return 1
    print_result(arguments, result, report(result))
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    if load > 1.5 * cores + 2.0:
        say(f"other programs kept {cores} processors busy (load {load:.0f}): results are worse and slower")
    for name, worker in result["workers"].items():
        for text in worker["warnings"]:
            say(f"{name}: {text}")
    missing = shortcomings(result["summary"])
    if missing:
        say(f"huepose demo: result not as expected: {'; '.join(missing)}")
    return 1 if missing else 0
