"""`huepose eval track`: tracking accuracy on sequences."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from huepose.datasets.types import Scene
from huepose.evaluation.paper_tracker import PaperTracker
from huepose.evaluation.pictures import PictureFolder
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.sources import LoopJudge
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import (
    Sources,
    TrackerLike,
    TrackOptions,
    evaluate_tracking,
)
from huepose.model import ReferenceModel
from huepose.paper.tracking import PaperStep
from huepose.profiles import profile
from huepose.propose.flow import compute
from huepose.support.errors import InputError
from huepose.support.words import known
from huepose_services import networks
from huepose_services.cli.evaluate_scenes import (
    figure_table,
    intervals_line,
    open_scenes,
    roft_line,
    shown,
    states_line,
)
from huepose_services.cli.pose_tables import PoseSources, warm_tracker


def call(arguments: argparse.Namespace) -> int:
    """Evaluate, print a table, write the results."""
    import cv2

    _check_method(arguments)
    cv2.setNumThreads(1)  # as the tracker's worker does
    options = _options(arguments)
    scenes, models = open_scenes(arguments.fast_ycb, arguments.bop, arguments.bundles)
    targets, settings = Targets(models, arguments.objects), profile(arguments.profile)
    used = {name: models[name] for name in shown(scenes, targets)}
    named = PoseSources(used, settings.estimator)

    def sources(scene: Scene, seed: int) -> Sources:
        first = named.of(options.init, scene.name, seed)
        if options.delayed is None:
            return Sources(first)
        same = options.delayed == options.init
        return Sources(first, first if same else named.of(options.delayed, scene.name, seed))

    judge = LoopJudge(used) if options.delayed == "estimate" else None
    pictures = PictureFolder(arguments.plots, targets) if arguments.plots else None
    on_frame = None if pictures is None else pictures.frame

    step = _paper_step(arguments) if arguments.method == "paper" else None

    def tracker(models: Mapping[str, ReferenceModel]) -> TrackerLike:
        return warm_tracker(models, settings.tracker) if step is None else PaperTracker(models, step)

    result = evaluate_tracking(scenes, targets, tracker, sources, options, judge=judge, on_frame=on_frame)
    record = result.as_json()
    record["summary"]["method"] = arguments.method
    if arguments.method == "paper":
        record["summary"] |= {"rotation": arguments.rotation, "flow": arguments.flow}
    record["summary"]["profile"] = arguments.profile
    print(_report(record["summary"]))
    write_json(arguments.json, record | {"origin": origin()})
    if pictures is not None:
        pictures.tracks(result)
    return 0


def _check_method(arguments: argparse.Namespace) -> None:
    """Raises InputError for options of the method paper that are given with another method."""
    given = {
        "--rotation": arguments.rotation != "direct",
        "--rotation-model": arguments.rotation_model is not None,
        "--flow": arguments.flow != "dis",
    }
    for option, there in given.items():
        if there and arguments.method != "paper":
            raise InputError(option, found=f"it with --method {arguments.method}", expected="--method paper")
    if arguments.rotation_model is not None and arguments.rotation == "kabsch":
        raise InputError("--rotation-model", found="it with --rotation kabsch", expected="a network to run")


def _paper_step(arguments: argparse.Namespace) -> PaperStep:
    flow = compute if arguments.flow == "dis" else networks.flow(arguments.flow)
    return PaperStep.of(arguments.rotation, arguments.rotation_model, flow)


def _options(arguments: argparse.Namespace) -> TrackOptions:
    """The options of the protocol. Raises InputError for --delayed with the protocol free."""
    delayed = arguments.delayed
    if arguments.protocol == "roft":
        delayed = delayed or "estimate"
    elif delayed is not None:
        raise InputError(
            "--delayed", found="it with --protocol free", fix="Use --protocol roft, or --init alone."
        )
    init = arguments.init or delayed or "estimate"
    return TrackOptions(arguments.protocol, arguments.every, tuple(arguments.seed), init, delayed)


def _report(summary: dict[str, Any]) -> str:
    blocks = {**summary["sequences"], "mean": summary, "all frames": summary["frame_weighted"]}
    more = {"instances": "n", "coverage_tracking": "TRACKING", "false_tracking_frames": "false"}
    drawn = f"of all frames, over {summary['interval95_over']}"
    delayed = f", late results {summary['delayed']}" if summary["delayed"] else ""
    return "\n".join(
        [
            figure_table("sequence", blocks, more),
            *([intervals_line(summary, drawn)] if summary["instances"] else []),
            roft_line(summary),
            states_line(summary),
            f"{summary['method']}, {summary['profile']}, {summary['protocol']}, every {summary['every']}, "
            f"first pose {summary['init']}{delayed}, seed {summary['seed']}; "
            f"{known(summary['fps'])} frames/s",
        ]
    )
