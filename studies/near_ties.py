"""How near ties are decided: collect contests between poses, and weigh what tells the right one.

    .venv/bin/python -m studies.near_ties --bop SCENE... --bundles bundles --json contests/heaps.json
    .venv/bin/python -m studies.near_ties --fit contests/heaps.json contests/piles.json --check real.json

A contest is what `huepose.select.near_ties` holds where poses score nearly alike. Those count in which
some contender is right and some is not. The fit is the largest likelihood of a softmax of the contenders'
weighted terms, no weight negative, every file counting alike; printed are, for the dense score alone, the
weights in use and the fitted ones, how often the right one wins and the likelihood (mean negative logarithm).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from huepose.datasets.types import Sample
from huepose.estimation import Estimator, ObjectQuery, PoseEstimate
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.estimate_rows import EstimateRow
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Targets, read_equivalents
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Bool, Float64
from huepose.model import load_models
from huepose.select.config import NearTieWeights
from huepose.select.near_ties import TERMS, Contest
from huepose.support.errors import InputError
from huepose_services.cli.evaluate_scenes import open_bop, shown

RIDGE = 0.005
"""Of the squared weights, each in units of its term's spread, against the likelihood."""


class Held(NamedTuple):
    """A contest: terms (K, 4) of its contenders, and which are right (K,)."""

    terms: Float64
    right: Bool


class Watching:
    """An estimator whose contests are kept, by instance, until the next frame."""

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator
        self.contests: dict[int, Contest] = {}

    def estimate(self, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[PoseEstimate]:
        """As the estimator does."""
        explained = self._estimator.explained(frame, queries)
        self.contests = {a.instance: e.contest for a, e in explained if e.contest is not None}
        return [answer for answer, _ in explained]


def collect(arguments: argparse.Namespace) -> list[Held]:
    """The contests of all labelled objects of some scenes."""
    scenes, models = open_bop(arguments.bop), load_models(arguments.bundles)
    targets = Targets(models, arguments.objects)
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    estimator = Estimator(models)
    estimator.warm_up(shown(scenes, targets))
    watching, out = Watching(estimator), []

    def on_frame(sample: Sample, _rows: list[EstimateRow]) -> None:
        for truth in sample.truths:
            held, model = watching.contests.get(truth.instance), targets.model_of(truth)
            if held is None or model is None or truth.T_cam_obj is None:
                continue
            same = equivalents.get((sample.scene, sample.image, truth.instance), ())
            right = [targets.right(model, T, truth.T_cam_obj, same) for T in held.poses]
            if any(right) and not all(right):
                out.append(Held(held.terms, np.array(right)))

    options = EstimateOptions(min_visib=0.3, seeds=tuple(arguments.seed))
    evaluate_estimates(scenes, targets, watching, options, equivalents=equivalents, on_frame=on_frame)
    return out


def likelihood(contests: Sequence[Held], weights: Float64) -> tuple[float, Float64]:
    """Mean negative logarithm of the chance that a softmax of the weighted terms gives the right ones, and
    its gradient by the weights (4,)."""
    total, gradient = 0.0, np.zeros(len(weights))
    for terms, right in contests:
        sums = terms @ weights
        chances = np.exp(sums - sums.max())
        chances /= chances.sum()
        hit = float(chances[right].sum()) + 1e-12
        total -= np.log(hit)
        gradient -= (np.where(right, chances, 0.0) / hit - chances) @ terms
    return total / len(contests), gradient / len(contests)


def fitted(sets: Sequence[Sequence[Held]]) -> Float64:
    """Weights (4,) of the largest likelihood over sets of contests, each set counting alike."""
    spread = np.concatenate([held.terms - held.terms.mean(0) for one in sets for held in one]).std(0) + 1e-9

    def loss(x: Float64) -> tuple[float, Float64]:
        parts = [likelihood(one, x / spread) for one in sets]
        slope = np.mean([g for _, g in parts], axis=0) / spread
        return float(np.mean([v for v, _ in parts]) + RIDGE * x @ x), slope + 2.0 * RIDGE * x

    bounds = [(0.0, None)] * len(TERMS)
    found = minimize(loss, np.ones(len(TERMS)), jac=True, method="L-BFGS-B", bounds=bounds)
    return np.asarray(found.x / spread)


def best_scale(sets: Sequence[Sequence[Held]], weights: Mapping[str, float]) -> Float64:
    """Weights (4,) in the proportion given, as sharp as suits the sets best."""
    w = np.array([weights[name] for name in TERMS])
    scales = np.geomspace(1.0, 60.0, 60)
    losses = [np.mean([likelihood(one, scale * w)[0] for one in sets]) for scale in scales]
    return np.asarray(scales[int(np.argmin(losses))] * w)


def read(path: Path) -> list[Held]:
    """The contests of a file that `--json` wrote."""
    record = json.loads(path.read_text())
    return [Held(np.array(c["terms"], dtype=float), np.array(c["right"], dtype=bool)) for c in record]


def report(fit: Mapping[str, Sequence[Held]], check: Mapping[str, Sequence[Held]]) -> str:
    """The table that is printed."""
    sets = list(fit.values())
    rows = {
        "dense score": best_scale(sets, {name: float(name == "dense") for name in TERMS}),
        "in use": best_scale(sets, asdict(NearTieWeights())),
        "fitted": fitted(sets),
    }
    lines = [
        f"{'right wins %, likelihood':26s}"
        + "".join(f"{n} ({len(c)})".rjust(22) for n, c in {**fit, **check}.items())
    ]
    for name, w in rows.items():
        cells = []
        for contests in {**fit, **check}.values():
            wins = np.mean([right[np.argmax(terms @ w)] for terms, right in contests])
            cells.append(f"{100.0 * wins:.1f}  {likelihood(contests, w)[0]:.3f}".rjust(22))
        lines.append(f"{name:26s}" + "".join(cells))
    w = rows["fitted"]
    lines.append("fitted: " + ", ".join(f"{n} {x / w[0]:.2f}" for n, x in zip(TERMS, w, strict=True)))
    return "\n".join(lines)


def main() -> None:
    """Collect or fit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bop", nargs="+", type=Path, default=[], help="scenes to collect contests in")
    parser.add_argument("--bundles", type=Path)
    parser.add_argument("--objects", nargs="+")
    parser.add_argument("--equivalent", type=Path)
    parser.add_argument("--seed", nargs="+", type=int, default=[0])
    parser.add_argument("--json", type=Path, help="where the contests go")
    parser.add_argument("--fit", nargs="+", type=Path, default=[], help="contests to fit to")
    parser.add_argument(
        "--check", nargs="+", type=Path, default=[], help="contests that the fit does not see"
    )
    arguments = parser.parse_args()
    if arguments.bop:
        if arguments.bundles is None or arguments.json is None:
            parser.error("--bop needs --bundles and --json")
        found = collect(arguments)
        write_json(arguments.json, [{"terms": h.terms.tolist(), "right": h.right.tolist()} for h in found])
        print(f"{len(found)} contests with a right and a wrong contender")
    elif arguments.fit:
        print(report({p.stem: read(p) for p in arguments.fit}, {p.stem: read(p) for p in arguments.check}))
    else:
        parser.error("give --bop to collect contests, or --fit to weigh them")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        raise SystemExit(f"near_ties: {error}") from None
