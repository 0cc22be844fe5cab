"""Which object is taken for which: every object asked for in the boxes of every other, each alone.

    .venv/bin/python -m studies.confusion --bop SCENE... --bundles DIR --json OUT.json --picture OUT.png

Each cell: mean quality of the column's object in boxes of the row's object, and the share of these boxes in
which it is acquired, that is, found with a quality over the acquisition level; on the diagonal that is the
share that is acquired as itself. An object that stands in the same picture is not asked for in another's box,
because it may well be in it, too; a cell for which no box is left is grey.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from huepose.datasets.bop import BopScene
from huepose.datasets.boxes import disturbed, truth_box
from huepose.datasets.types import GroundTruth
from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery, PoseEstimate
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets, object_number
from huepose.geometry.arrays import Float64, UInt8
from huepose.model import ReferenceModel, load_models
from huepose.support.progress import progress
from studies.absent import asking


def main() -> None:
    """Choose boxes, ask for everything in each, print and draw."""
    arguments = _arguments()
    models = load_models(arguments.bundles)
    targets = Targets(models, arguments.objects)
    shown = sorted(targets.models, key=lambda m: str(object_number(m)).zfill(4))
    boxes = _boxes(arguments, targets)
    estimator = Estimator(models, EstimatorConfig(method=arguments.method))
    estimator.warm_up([m.name for m in shown])
    rows: list[dict[str, Any]] = []
    for scene, image, truth, model in progress(boxes, "boxes"):
        frame = scene.frame(image)
        true_box = truth_box(truth, model.mesh, frame.camera)
        if true_box is None:
            continue
        size = (frame.camera.width, frame.camera.height)
        box = disturbed(true_box, "perturbed", 0, scene.name, image, truth.instance, *size)
        place = {"scene": scene.name, "image": image, "instance": truth.instance, "shown": model.name}
        here = {m.name for t in scene.truths(image) if (m := targets.model_of(t)) is not None}
        asked = [m for m in shown if m.name == model.name or m.name not in here]
        rows += [{**place, **_said(estimator.explain(frame, ObjectQuery(m.name, box))[0])} for m in asked]
    names = [m.name for m in shown]
    acquired, quality = _matrix(rows, names, "acquired"), _matrix(rows, names, "quality")
    wrong = [r for r in rows if r["shown"] != r["asked"]]
    summary = {
        "boxes": len(boxes),
        "asked_for_another": len(wrong),
        "found_another_percent": 100.0 * float(np.mean([r["found"] for r in wrong])),
        "acquired_another_percent": 100.0 * float(np.mean([r["acquired"] for r in wrong])),
        "best_is_right_percent": best_is_right(rows),
    }
    write_json(
        arguments.json, {"summary": summary, "acquired": acquired, "quality": quality, "answers": rows}
    )
    short = [str(object_number(m)) for m in shown]
    lines = [[name, *line] for name, line in zip(names, acquired.tolist(), strict=True)]
    print(table(["box of \\ asked", *short], lines))
    print(summary)
    if arguments.picture is not None:
        picture = drawn(quality, acquired, names)
        cv2.imwrite(str(arguments.picture), np.ascontiguousarray(picture[..., ::-1]))


def _said(answer: PoseEstimate) -> dict[str, Any]:
    """What was answered when an object was asked for."""
    return {
        "asked": answer.object,
        "found": answer.found,
        "quality": answer.quality,
        "acquired": answer.state == "TRACKING",
    }


def _boxes(
    arguments: argparse.Namespace, targets: Targets
) -> list[tuple[BopScene, int, GroundTruth, ReferenceModel]]:
    """Up to `--boxes` labels of each object that are seen by half or more, spread over the scenes."""
    known: dict[str, list[tuple[BopScene, int, GroundTruth, ReferenceModel]]] = {}
    for scene in map(BopScene, arguments.bop):
        for image in scene.image_ids:
            for truth in scene.truths(image):
                model = targets.model_of(truth)
                enough = truth.shows(0.5)
                if model is not None and targets.wants(truth) and enough:
                    known.setdefault(model.name, []).append((scene, image, truth, model))
    chosen = []
    for each in known.values():
        steps = np.linspace(0, len(each), min(arguments.boxes, len(each)), endpoint=False).astype(int)
        chosen += [each[k] for k in steps]
    return chosen


def _matrix(rows: list[dict[str, Any]], names: list[str], key: str) -> Float64:
    """Mean of a field over the boxes, percent (N, N): rows are what is shown, columns what is asked for; nan
    where nothing was asked."""
    total, count = np.zeros((len(names),) * 2), np.zeros((len(names),) * 2)
    for row in rows:
        at = names.index(row["shown"]), names.index(row["asked"])
        total[at] += float(row[key])
        count[at] += 1
    return np.where(count > 0, 100.0 * total / np.maximum(count, 1), np.nan)


def best_is_right(rows: list[dict[str, Any]]) -> float:
    """Of the boxes, the share in which the object that is there gets the highest quality of all asked."""
    boxes: dict[tuple[str, int, int], list[dict[str, Any]]] = {}
    for row in rows:
        boxes.setdefault((row["scene"], row["image"], row["instance"]), []).append(row)
    best = [max(group, key=lambda r: float(r["quality"])) for group in boxes.values()]
    return 100.0 * float(np.mean([r["shown"] == r["asked"] for r in best]))


def drawn(quality: Float64, acquired: Float64, names: list[str]) -> UInt8:
    """A picture of the matrix: darker is a higher mean quality; the number is the share acquired."""
    cell, left, top = 34, 190, 150
    n = len(names)
    picture = np.full((top + n * cell + 10, left + n * cell + 10, 3), 255, np.uint8)
    font = cv2.FONT_HERSHEY_SIMPLEX
    for i in range(n):
        cv2.putText(picture, names[i][:26], (4, top + i * cell + 22), font, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
        for j in range(n):
            x, y, q = left + j * cell, top + i * cell, quality[i, j] / 100.0
            full = np.array([60, 150, 80]) if i == j else np.array([205, 60, 50])
            color = tuple(int(c) for c in 255 + q * (full - 255)) if np.isfinite(q) else (235, 235, 235)
            cv2.rectangle(picture, (x, y), (x + cell - 2, y + cell - 2), color, -1)
            if acquired[i, j] >= 0.5:
                text = f"{acquired[i, j]:.0f}"
                cv2.putText(picture, text, (x + 4, y + 22), font, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    heads = np.full((n * cell, top, 3), 255, np.uint8)
    for j in range(n):
        cv2.putText(heads, names[n - 1 - j][:20], (4, j * cell + 22), font, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    picture[:top, left : left + n * cell] = cv2.rotate(heads, cv2.ROTATE_90_CLOCKWISE)
    return picture


def _arguments() -> argparse.Namespace:
    parser = asking("Every object asked for in the box of every other.")
    parser.add_argument("--picture", type=Path, default=None, metavar="OUT.png")
    parser.add_argument("--boxes", type=int, default=3, metavar="N", help="of each object (3)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
