"""Is it said that an object is not there? Each asked for, alone, in boxes of others and in boxes of nothing.

    .venv/bin/python benchmarks/wrong_boxes.py --bop SCENE... --bundles DIR --json OUT.json

Only objects that do not stand in the picture are asked for. The rows can be fitted to: `huepose eval
calibrate RESULT.json --others OUT.json`, where all that was looked at counts, found or not.
"""

from __future__ import annotations

import argparse

import numpy as np
from options import asking

from huepose.datasets.bop import BopScene
from huepose.estimation import Estimator, EstimatorConfig
from huepose.evaluation.absent import NOTHING, answers_where_absent, questions
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.model import load_models


def main() -> None:
    """Ask, print how often something is found and how often it is acquired."""
    arguments = _arguments()
    models = load_models(arguments.bundles)
    targets = Targets(models, arguments.objects)
    asked = list(questions([BopScene(path) for path in arguments.bop], targets, arguments.per_frame))
    estimator = Estimator(models, EstimatorConfig(method=arguments.method))
    estimator.warm_up([model.name for model in targets.models])
    rows = answers_where_absent(estimator, asked)
    lines = []
    for name, chosen in (
        ("boxes of others", [row for row in rows if row["shown"] != NOTHING]),
        ("boxes of nothing", [row for row in rows if row["shown"] == NOTHING]),
        ("all", rows),
    ):
        found = [row["found"] for row in chosen]
        acquired = [row["state"] == "TRACKING" for row in chosen]
        lines.append([name, len(chosen), 100.0 * np.mean(found), 100.0 * np.mean(acquired)])
    write_json(arguments.json, {"rows": rows})
    print(table(["asked where it is not", "n", "found %", "acquired %"], lines))


def _arguments() -> argparse.Namespace:
    parser = asking("How often something is found where the object is not.")
    parser.add_argument("--per-frame", type=int, default=3, metavar="N", help="questions a frame (3)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
