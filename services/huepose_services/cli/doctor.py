"""`huepose doctor`: check what this machine has, and what would stop a pipeline."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from huepose.support.errors import InputError
from huepose_services.cli.options import add_json, print_result


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "doctor", help="check this machine: versions, limits, cameras, models, clock"
    )
    parser.add_argument(
        "config", nargs="?", type=Path, metavar="PIPELINE", help="also check what this pipeline needs"
    )
    parser.add_argument(
        "--camera", action="store_true", help="also open each camera of PIPELINE and check its images"
    )
    add_json(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Run all checks; exit code 1 if something is BAD."""
    from huepose_services.doctor.checks import examine
    from huepose_services.runtime.config_file import load_all

    configs = [] if arguments.config is None else load_all(arguments.config)
    if arguments.camera and not configs:
        fix = "huepose doctor PIPELINE.yaml --camera"
        raise InputError("--camera", found="no PIPELINE", expected="the file that names the camera", fix=fix)
    findings = examine(configs)
    if arguments.camera:
        from huepose_services.doctor.pictures import pictures

        for config in configs:
            of = f"{config.camera.name} " if len(configs) > 1 else ""
            findings += [replace(one, subject=f"{of}{one.subject}") for one in pictures(config)]
    lines = [finding.line() for finding in findings]
    if not configs:
        lines.append("\nTo check a camera and objects in its images: huepose doctor pipeline.yaml --camera")
    print_result(arguments, [asdict(finding) for finding in findings], "\n".join(lines))
    return 1 if any(finding.bad for finding in findings) else 0
