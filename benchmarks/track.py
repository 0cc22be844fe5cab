"""Tracking baselines and HuePose's tracker on the same sequences in one run, from the true first pose.

.venv/bin/python benchmarks/track.py --fast-ycb SEQUENCE... --bundles DIR --json OUT.json
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from track_rivals import LastPoseTracker, careful_icp, color_icp, flow_pairs

from huepose.datasets.types import Scene
from huepose.evaluation.result_files import write_json
from huepose.evaluation.sources import TruthSource
from huepose.evaluation.summary import span, table
from huepose.evaluation.targets import Targets
from huepose.evaluation.track_protocol import Sources, TrackerLike, TrackOptions, evaluate_tracking
from huepose.model import ReferenceModel
from huepose.tracking import Tracker
from huepose_services.cli.evaluate_scenes import open_fast_ycb

METHODS = ("huepose", "icp", "icp-velocity", "color-icp", "flow-pairs")


def tracker_of(name: str, models: Mapping[str, ReferenceModel]) -> TrackerLike:
    """A new tracker."""
    if name == "huepose":
        tracker = Tracker(models)
        tracker.warm_up()
        return tracker
    steps = {
        "icp": careful_icp,
        "icp-velocity": careful_icp,
        "color-icp": color_icp,
        "flow-pairs": flow_pairs,
    }
    return LastPoseTracker(models, steps[name], constant_velocity=name == "icp-velocity")


def main() -> None:
    """Run the methods one after the other, print a table, write JSON."""
    arguments = _arguments()
    scenes, models = open_fast_ycb(arguments.fast_ycb, arguments.bundles)
    targets = Targets(models)
    record: dict[str, Any] = {"options": {k: str(v) for k, v in vars(arguments).items()}, "methods": {}}
    rows = []
    for every in arguments.every:
        for name in arguments.methods:
            block = _run(scenes, targets, name, every)
            record["methods"][f"{name}, every {every}"] = block
            rows.append(
                [name, every, block["auc_add"], block["auc_adds"], block["all_frames"]["auc_add"],
                 span(block["interval95"], 0), f"{block['seconds_p50'] * 1000:.1f}",
                 *block["sequences"].values()]
            )  # fmt: skip
            write_json(arguments.json, record)
            print(rows[-1], flush=True)
    names = [scene.name for scene in scenes]
    heading = ["method", "every", "AUC ADD", "AUC ADD-S", "all frames", "95 %", "ms per frame", *names]
    print(table(heading, rows))


def _run(scenes: list[Scene], targets: Targets, name: str, every: int) -> dict[str, Any]:
    """Figures of one method: the mean over sequences, and over all frames with the interval."""
    result = evaluate_tracking(
        scenes,
        targets,
        lambda models: tracker_of(name, models),
        lambda scene, seed: Sources(TruthSource()),
        TrackOptions("free", every),
    )
    summary = result.summary()
    return {
        "auc_add": summary["auc_add"],
        "auc_adds": summary["auc_adds"],
        "recall_add": summary["recall_add"],
        "all_frames": {key: summary["frame_weighted"][key] for key in ("auc_add", "auc_adds", "recall_add")},
        "interval95": summary["interval95"]["auc_add"],
        "seconds_p50": float(np.median([row.seconds for row in result.rows])),
        "sequences": {key: block["auc_add"] for key, block in summary["sequences"].items()},
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Tracking baselines and HuePose on the same sequences.")
    parser.add_argument("--fast-ycb", type=Path, nargs="+", required=True, metavar="SEQ_DIR")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--every", type=int, nargs="+", default=[1, 5], metavar="N")
    return parser.parse_args()


if __name__ == "__main__":
    main()
