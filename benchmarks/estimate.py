"""Single-frame baselines and HuePose on the same instances: accuracy, intervals, CPU time per object.

    .venv/bin/python benchmarks/estimate.py --bop SCENE... --bundles DIR --json OUT.json

It can be interrupted, and run later with other methods, masks or images: results in the file are not computed
again. The table has all results in the file for the chosen methods, masks and images.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from open3d_rivals import Features, ManyStarts
from ppf_rival import PointPairFeatures
from rival import Ours, Rival, RivalEstimator

from huepose.datasets.bop import BopScene
from huepose.datasets.types import SomeImages
from huepose.estimation import Estimator, EstimatorConfig
from huepose.evaluation.estimate_protocol import EstimateOptions, evaluate_estimates
from huepose.evaluation.estimate_rows import EstimateRow, summary_of
from huepose.evaluation.instances import labels_of
from huepose.evaluation.metrics import FIGURES
from huepose.evaluation.summary import span, table
from huepose.evaluation.tables.journal import Journal, models_digest
from huepose.evaluation.targets import Targets, read_equivalents
from huepose.model import ReferenceModel, load_models
from huepose.support.progress import progress

COMMON = ("boxes", "min_visib", "seed", "objects", "equivalent")
"""Options that all results in a file share, beside the reference models."""


Image = tuple[str, int]
"""Scene folder and number of an image."""


def main() -> None:
    """Run the methods one after the other, image by image, write JSON, and print a table."""
    arguments = _arguments()
    models = load_models(arguments.bundles)
    targets = Targets(models, arguments.objects)
    equivalents = read_equivalents(arguments.equivalent) if arguments.equivalent else {}
    common = {name: str(getattr(arguments, name)) for name in COMMON}
    journal = Journal(arguments.json, {**common, "models": models_digest(targets.models)})
    images = [
        (scene, image)
        for scene in map(BopScene, arguments.bop)
        for image in scene.image_ids[:: arguments.every]
        if any(label.counted for label in labels_of(scene.truths(image), targets, arguments.min_visib)[0])
    ]
    for name in arguments.methods:
        wanted = [
            (masks, scene, image)
            for masks in arguments.masks
            for scene, image in images
            if not journal.done(key_of(name, masks, _image(scene, image)))
        ]
        if not wanted:
            continue
        estimator = _methods(models)[name]()
        estimator.warm_up()
        for masks, scene, image in progress(wanted, name):
            options = EstimateOptions(arguments.boxes, masks, arguments.min_visib, (arguments.seed,))
            estimator.cpu_s.clear()
            one = [SomeImages(scene, [image])]
            result = evaluate_estimates(one, targets, estimator, options, equivalents=equivalents)
            piece = piece_of(_image(scene, image), result.rows, estimator.cpu_s)
            journal.add(key_of(name, masks, _image(scene, image)), piece)
    print(_figures(journal, arguments, [_image(scene, image) for scene, image in images]))


def _image(scene: BopScene, image: int) -> Image:
    """An image by the folder of its scene: scenes of different sets share names."""
    return str(scene.path.resolve()), image


def key_of(method: str, masks: str, image: Image) -> str:
    """The key of one image in the journal."""
    return f"{method}, masks {masks}, {image[0]}/{image[1]}"


def piece_of(image: Image, rows: Sequence[EstimateRow], cpu_s: Sequence[float]) -> dict[str, Any]:
    """The journal's entry of one image: the estimates and the CPU seconds of each."""
    records = [row.as_json() for row in rows]
    short = [{k: v for k, v in row.items() if k not in ("terms", "alternatives", "box")} for row in records]
    return {"scene": image[0], "image": image[1], "cpu_s": list(cpu_s), "rows": short}


def summary(journal: Journal, method: str, masks: str, images: Sequence[Image]) -> dict[str, Any] | None:
    """Figures over the images with results, as in a result file, with `cpu_s_p50` and `cpu_s_mean` per
    object; None without results."""
    keys = [key_of(method, masks, image) for image in images]
    pieces = [journal.entries[key] for key in keys if key in journal.entries]
    # Scenes of different sets share names, so a row names its folder.
    rows = [{**row, "scene": piece["scene"]} for piece in pieces for row in piece["rows"]]
    if not rows:
        return None
    seconds = np.array([s for piece in pieces for s in piece["cpu_s"] if s > 0])
    spent = {"cpu_s_p50": float(np.median(seconds)), "cpu_s_mean": float(seconds.mean())}
    return {**summary_of(rows), **spent}


def _figures(journal: Journal, arguments: argparse.Namespace, images: Sequence[Image]) -> str:
    """Two tables of the journal's results on these images: all figures, and recall by object."""
    found = {
        (name, masks): summary(journal, name, masks, images)
        for masks in arguments.masks
        for name in arguments.methods
    }
    rows = []
    for (name, masks), figures in found.items():
        if figures is None:
            continue
        spans = figures["interval95"]
        cells = [f"{figures[k]:.1f} ({span(spans[k], 0)})" for k in FIGURES]
        rows.append([name, masks, figures["instances"], *cells, f"{figures['cpu_s_p50']:.3f}"])
    heading = ["method", "masks", "n", "ADD", "ADD-S", "AUC ADD", "AUC ADD-S", "CPU s"]
    known = {f"{name}, masks {masks}": s for (name, masks), s in found.items() if s is not None}
    return table(heading, rows) + "\n" + _by_object(known)


def _by_object(methods: Mapping[str, Any]) -> str:
    """ADD recall of each method on each object."""
    numbers = sorted({n for figures in methods.values() for n in figures["per_object"]}, key=str)
    rows = [
        [name, *(figures["per_object"].get(n, {}).get("recall_add") for n in numbers)]
        for name, figures in methods.items()
    ]
    return table(["recall ADD by object", *map(str, numbers)], rows)


def _methods(models: Mapping[str, ReferenceModel]) -> dict[str, Callable[[], Ours | RivalEstimator]]:
    """Functions that make the estimator of each method."""

    def rival(make: Callable[[], Rival]) -> Callable[[], RivalEstimator]:
        return lambda: RivalEstimator(make(), models)

    return {
        "full": lambda: Ours(Estimator(models, EstimatorConfig(method="full"))),
        "full-together": lambda: Ours(Estimator(models, EstimatorConfig(method="full")), together=True),
        "colorpair": lambda: Ours(Estimator(models, EstimatorConfig(method="colorpair"))),
        "fpfh-ransac": rival(lambda: Features(fast=False)),
        "fgr": rival(lambda: Features(fast=True)),
        "icp-60": rival(ManyStarts),
        "icp-60-color": rival(lambda: ManyStarts(by_color=True)),
        "ppf": rival(lambda: PointPairFeatures(Path("build/rivals/bin/python"))),
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ("full", "full-together", "colorpair", "fpfh-ransac", "fgr", "icp-60", "icp-60-color", "ppf")
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    journal = "a journal of results; those in it are not computed again"
    parser.add_argument("--json", type=Path, required=True, metavar="FILE", help=journal)
    parser.add_argument("--methods", nargs="+", choices=names, default=list(names))
    parser.add_argument("--masks", nargs="+", choices=("auto", "gt"), default=["auto", "gt"])
    parser.add_argument("--boxes", choices=("perturbed", "paper", "gt"), default="perturbed")
    parser.add_argument("--objects", nargs="+", default=None, metavar="ID")
    parser.add_argument("--equivalent", type=Path, default=None, metavar="FILE")
    parser.add_argument("--min-visib", type=float, default=0.3, metavar="F")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only every N-th image (1)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the disturbed boxes")
    return parser.parse_args()


if __name__ == "__main__":
    main()
