"""`huepose eval perception`: boxes and masks of whole frames."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import Any

from huepose.estimation import Estimator
from huepose.evaluation.perception_protocol import PerceptionOptions, evaluate_perception
from huepose.evaluation.perception_rows import FIRST
from huepose.evaluation.pictures import write_perception
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.summary import span, table
from huepose.evaluation.targets import Targets
from huepose.model import load_models
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.support.words import counted
from huepose_services.cli.evaluate_scenes import open_bop


def call(arguments: argparse.Namespace) -> int:
    """Evaluate, print a table, write the results."""
    scenes = open_bop(arguments.bop)
    targets = Targets(load_models(arguments.bundles), arguments.objects)
    models = {model.name: model for model in targets.models}
    settings = profile(arguments.profile)
    judged, least = settings.detector.proposals, settings.detector.min_score
    # More boxes than are scored, for the recall of the first N.
    asked = replace(
        settings.detector,
        sources=tuple(arguments.sources),
        proposals=max(judged, *FIRST),
        min_score=0.0,
        threads=arguments.threads,
    )
    detector = ViewDetector(models, asked)
    detector.warm_up()
    segmenter = DepthSegmenter()
    # The presence decides which boxes show their object, not the quality.
    config = replace(settings.estimator, threads=arguments.threads, found_level=0.0)
    estimator = Estimator(models, config, segmenter)
    estimator.warm_up()
    result = evaluate_perception(
        scenes,
        targets,
        detector,
        segmenter,
        estimator,
        PerceptionOptions(judged, least, seed=arguments.seed),
        on_frame=partial(write_perception, arguments.plots) if arguments.plots else None,
    )
    record = result.as_json()
    how = {"detector": "views", "sources": arguments.sources, "segmenter": "depth"}
    record["summary"] |= how | {"profile": arguments.profile}
    print(_report(record["summary"]))
    write_json(arguments.json, record | {"origin": origin()})
    return 0


def _report(summary: dict[str, Any]) -> str:
    """The tables that are printed at the end."""
    counts = sorted(summary["recall_at"])
    heading = ["object", "n", "recall", *(f"at {n}" for n in counts), "false", "mask IoU", "final IoU"]

    def line(name: str, block: dict[str, Any], false: object) -> list[object]:
        ious = [None if x is None else f"{x:.3f}" for x in (block["mask_iou"], block["final_mask_iou"])]
        at = [block["recall_at"][n] for n in counts]
        return [name, block["instances"], block["recall_iou50"], *at, false, *ious]

    lines = [line(name, block, block["false_boxes"]) for name, block in summary["per_object"].items()]
    lines.append(line("all", summary, f"{summary['false_boxes_per_frame']:.2f}/frame"))
    text = [table(heading, lines), ""]
    of_others = {
        name: [f"{other} {n}" for other, n in shown.items() if other != name]
        for name, shown in summary["confusion"].items()
    }
    if any(of_others.values()):
        text.append("false boxes, by what is really there:")
        text += [f"  {name}: {', '.join(others)}" for name, others in of_others.items() if others]
    recall, false = (summary["interval95"][key] for key in ("recall_iou50", "false_boxes_per_frame"))
    text.append(f"95 % intervals over frames: recall {span(recall)}, false a frame {span(false, 2)}")
    text.append(
        f"{summary['profile']}: {counted(summary['frames'], 'frame')}, "
        f"{counted(summary['asked_for'], 'object')} asked for; "
        f"detector {summary['detector_seconds_per_frame_p50']:.2f} s a frame, "
        f"with the estimator's verdict {summary['seconds_per_frame_p50']:.2f} s"
    )
    return "\n".join(text)
