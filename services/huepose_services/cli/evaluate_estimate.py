"""`huepose eval estimate`: single-frame accuracy."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from huepose.datasets import files
from huepose.datasets.bop_detections import BopDetections, read_detections
from huepose.estimation import Estimator
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.pictures import PictureFolder
from huepose.evaluation.pose_files import BopResult, write_bop_csv
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.summary import Row
from huepose.evaluation.targets import Targets, read_equivalents
from huepose.model import load_models
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.support.errors import InputError
from huepose.support.words import known, listed
from huepose_services.cli.evaluate_scenes import (
    bop_objects,
    figure_table,
    intervals_line,
    open_bop,
    open_ycbv_folder,
    scene_names,
    shown,
)

_BOP = ("AR", "AR_VSD", "AR_MSSD", "AR_MSPD")


def call(arguments: argparse.Namespace) -> int:
    """Evaluate, print a table, write the results."""
    models = load_models(arguments.bundles)
    scenes = open_ycbv_folder(arguments.ycbv).scenes if arguments.ycbv else open_bop(arguments.bop)
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    paths = arguments.bop if equivalents and not arguments.ycbv else []
    if alike := sorted({*scene_names(paths)} - {*map(files.folder_name, paths)}):
        raise InputError(
            "--equivalent",
            found=f"scenes of several sets with one name ({listed(alike)})",
            expected="scenes with names of their own, as the file names them",
            fix="Evaluate one set at a time.",
        )
    boxes, given = box_source(arguments.boxes)
    if given is not None and (unnumbered := [s.name for s in scenes if not s.name.isdigit()]):
        raise InputError(
            f"--boxes {arguments.boxes}",
            found=f"scenes whose name is no number ({listed(unnumbered)})",
            expected="folders named by the scene_id that the file gives",
            fix="Rename them; evaluate sets with the same numbers one at a time.",
        )
    options = EstimateOptions(boxes, arguments.masks, arguments.min_visib, tuple(arguments.seed))
    targets = Targets(models, arguments.objects)
    # In boxes of the detector, the presence decides what is found, not the quality.
    found_level = 0.0 if boxes == "detect" else None
    settings = profile(arguments.profile)
    config = replace(
        settings.estimator, method=arguments.method, threads=arguments.threads, found_level=found_level
    )
    estimator = Estimator(models, config)
    detector = None
    if boxes == "detect":
        searching = replace(settings.detector, threads=arguments.threads)
        detector = ViewDetector({model.name: model for model in targets.models}, searching)
        detector.warm_up()
        estimator.warm_up([model.name for model in targets.models])
    else:
        estimator.warm_up(shown(scenes, targets))
    pictures = PictureFolder(arguments.plots, targets) if arguments.plots else None
    result = evaluate_estimates(
        scenes,
        targets,
        estimator,
        options,
        equivalents=equivalents,
        detector=detector,
        on_frame=None if pictures is None else pictures.frame,
        given=given,
        bop_objects=bop_objects(arguments.models_info, models) if arguments.models_info else {},
    )
    record = result.as_json()
    record["summary"] |= {"method": arguments.method, "profile": arguments.profile}
    print(_report(record["summary"]))
    write_json(arguments.json, record | {"origin": origin()})
    if arguments.csv:
        rows = [row.as_json() for row in result.rows if row.seed == result.seeds[0]]
        write_bop_csv(arguments.csv, bop_results(rows))
    return 0


def box_source(given: str) -> tuple[Any, BopDetections | None]:
    """The meaning of `--boxes`: a kind of box, or `file` and its detections. Raises InputError."""
    if given in ("perturbed", "paper", "gt", "detect"):
        return given, None
    return "file", read_detections(given)


def bop_results(rows: Iterable[Row]) -> list[BopResult]:
    """Rows of a result file in the format of bop_toolkit: the poses of objects with a BOP id."""
    return [
        BopResult(
            row["scene"],
            row["image"],
            row["object"],
            row["quality"],
            np.array(row["T_cam_obj"]),
            row["seconds"],
        )
        for row in rows
        if row["T_cam_obj"] is not None and isinstance(row["object"], int)
    ]


def _report(summary: dict[str, Any]) -> str:
    """The table that is printed at the end."""
    blocks = {**summary["per_object"], "all": summary}
    lines = [figure_table("object", blocks, {"instances": "n"})]
    if summary["instances"]:
        lines.append(intervals_line(summary, "over frames"))
    without = [str(name) for name, block in summary["per_object"].items() if block.get("ar") is None]
    if summary.get("ar") is not None:
        lines.append("BOP: " + ", ".join(f"{k.upper()} {summary[k.lower()]:.1f}" for k in _BOP))
    elif len(without) < len(summary["per_object"]):
        lines.append(f"BOP: no AR of all, because models_info.json has no diameter of {', '.join(without)}")
    if summary["recall_add_official"] != summary["recall_add"]:
        official = f"{summary['recall_add_official']:.1f}, AUC {summary['auc_add_official']:.1f}"
        lines.append(f"against the labels as they are: ADD {official}")
    if summary["boxes"] == "detect":
        lines.append(f"poses that belong to no label: {summary['false_poses']:g}")
    lines.append(
        f"{summary['method']}, {summary['profile']}, boxes {summary['boxes']}, masks {summary['masks']}, "
        f"seed {summary['seed']}; calibration error {known(summary['ece'], '.3f')}; "
        f"{summary['seconds_per_frame_p50']:.2f} s a frame; "
        f"{summary['skipped_no_bundle']} labels without reference model skipped"
    )
    return "\n".join(lines)
