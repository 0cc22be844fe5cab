"""Single-frame rivals and HuePose on the same instances in one run: accuracy, intervals, CPU time an object.

.venv/bin/python benchmarks/estimate.py --bop SCENE... --bundles DIR --json OUT.json
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from open3d_rivals import Features, ManyStarts
from ppf_rival import PointPairFeatures
from rival import EveryNth, Ours, Rival, RivalEstimator

from huepose.datasets.bop import BopScene
from huepose.estimation import Estimator, EstimatorConfig
from huepose.evaluation.equivalents import read_equivalents
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.model import ReferenceModel, load_models

FIGURES = ("recall_add", "recall_adds", "auc_add", "auc_adds")


def main() -> None:
    """Run the methods one after the other, print a table, write JSON."""
    arguments = _arguments()
    models = load_models(arguments.bundles)
    targets = Targets(models, arguments.objects)
    scenes = [EveryNth(BopScene(path), arguments.every) for path in arguments.bop]
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    makers = _methods(models, arguments)
    record: dict[str, Any] = {"options": {k: str(v) for k, v in vars(arguments).items()}, "methods": {}}
    rows = []
    for masks in arguments.masks:
        for name in arguments.methods:
            estimator = makers[name]()
            if isinstance(estimator, Ours):
                estimator.estimator.warm_up()
            options = EstimateOptions(arguments.boxes, masks, arguments.min_visib, (arguments.seed,))
            result = evaluate_estimates(scenes, targets, estimator, options, equivalents=equivalents)
            summary = result.summary()
            seconds = np.array([s for s in estimator.cpu_s if s > 0])
            summary["cpu_s_p50"], summary["cpu_s_mean"] = float(np.median(seconds)), float(seconds.mean())
            record["methods"][f"{name}, masks {masks}"] = summary
            spans = summary["interval95"]
            cells = [f"{summary[k]:.1f} ({spans[k][0]:.0f} to {spans[k][1]:.0f})" for k in FIGURES]
            rows.append([name, masks, summary["instances"], *cells, f"{summary['cpu_s_p50']:.3f}"])
            print(rows[-1], flush=True)
            write_json(arguments.json, record)
    heading = ["method", "masks", "n", "ADD", "ADD-S", "AUC ADD", "AUC ADD-S", "CPU s"]
    print(table(heading, rows))
    print(_by_object(record["methods"]))


def _by_object(methods: Mapping[str, Any]) -> str:
    """ADD recall of each method on each object."""
    numbers = sorted({n for summary in methods.values() for n in summary["per_object"]}, key=str)
    rows = [
        [name, *(summary["per_object"].get(n, {}).get("recall_add") for n in numbers)]
        for name, summary in methods.items()
    ]
    return table(["recall ADD by object", *map(str, numbers)], rows)


def _methods(
    models: Mapping[str, ReferenceModel], arguments: argparse.Namespace
) -> dict[str, Callable[[], Ours | RivalEstimator]]:
    """What makes each method."""

    def rival(make: Callable[[], Rival]) -> Callable[[], RivalEstimator]:
        return lambda: RivalEstimator(make(), models)

    return {
        "full": lambda: Ours(Estimator(models, EstimatorConfig(method="full"))),
        "colorpair": lambda: Ours(Estimator(models, EstimatorConfig(method="colorpair"))),
        "fpfh-ransac": rival(lambda: Features(fast=False)),
        "fgr": rival(lambda: Features(fast=True)),
        "icp-60": rival(ManyStarts),
        "ppf": rival(lambda: PointPairFeatures(arguments.rivals / "bin" / "python")),
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ("full", "colorpair", "fpfh-ransac", "fgr", "icp-60", "ppf")
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--methods", nargs="+", choices=names, default=list(names))
    parser.add_argument("--masks", nargs="+", choices=("auto", "gt"), default=["auto", "gt"])
    parser.add_argument("--boxes", choices=("perturbed", "paper", "gt"), default="perturbed")
    parser.add_argument("--objects", nargs="+", default=None, metavar="ID")
    parser.add_argument("--equivalent", type=Path, default=None, metavar="FILE")
    parser.add_argument("--min-visib", type=float, default=0.3, metavar="F")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th image (1)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the disturbed boxes")
    parser.add_argument("--rivals", type=Path, default=Path("build/rivals"), metavar="DIR",
                        help="environment made by make_env.sh")  # fmt: skip
    return parser.parse_args()


if __name__ == "__main__":
    main()
