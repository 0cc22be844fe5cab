"""Is an absent object reported as absent? It is estimated alone, in the box of another object or anywhere.

    .venv/bin/python -m studies.absent --bop SCENE... --bundles DIR --json OUT.json

Only objects that are not in the image are asked for. Quality is fitted to such rows, too (`studies.quality`):
there all rows count, found or not.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from huepose.datasets.bop import BopScene
from huepose.datasets.boxes import disturbed, truth_box
from huepose.datasets.types import GroundTruth, Scene
from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.evaluation.calibration import Judged, judged, read_rows
from huepose.evaluation.result_files import write_json
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets, object_number
from huepose.geometry.box import Box
from huepose.model import ReferenceModel, load_models
from huepose.support.progress import progress

NOTHING = "nothing"
PER_FRAME = 3
"""Absent objects that are asked for in each frame."""


@dataclass(frozen=True, eq=False)
class Question:
    """An object that is not in the image, and the box in which it is asked for; shown: the object that the
    box belongs to, or NOTHING for a random box."""

    scene: Scene
    image: int
    number: int
    model: ReferenceModel
    box: Box
    shown: str


def questions(scenes: Sequence[Scene], targets: Targets, seed: int = 0) -> Iterator[Question]:
    """`PER_FRAME` questions for each frame, about objects without a label in it; the last has a random
    box."""
    rng = np.random.default_rng([seed, 41])
    for scene in scenes:
        for image in scene.image_ids:
            truths = scene.truths(image)
            here = {model.name for t in truths if (model := targets.model_of(t)) is not None}
            away = [model for model in targets.models if model.name not in here]
            places = _places(scene, image, truths, targets) if away else []
            for number in range(PER_FRAME if places else 0):
                model = away[rng.integers(len(away))]
                box, shown = places[rng.integers(len(places))]
                if number == PER_FRAME - 1:
                    camera = scene.frame(image).camera
                    x = rng.uniform(0.0, max(1.0, camera.width - box.w))
                    y = rng.uniform(0.0, max(1.0, camera.height - box.h))
                    box, shown = Box(x, y, box.w, box.h).clipped(camera.width, camera.height), NOTHING
                yield Question(scene, image, number, model, box, shown)


def answers_where_absent(estimator: Estimator, asked: Sequence[Question]) -> list[dict[str, Any]]:
    """Rows as of `huepose eval estimate`, none of them right; each question is asked alone."""
    rows = []
    for q in progress(asked, "absent"):
        answer, _ = estimator.explain(q.scene.frame(q.image), ObjectQuery(q.model.name, q.box))
        terms = None if answer.terms is None else asdict(answer.terms)
        rows.append({
            "object": object_number(q.model), "found": answer.found, "right": False,
            "quality": answer.quality, "state": answer.state, "terms": terms, "scene": q.scene.name,
            "image": q.image, "instance": q.number, "shown": q.shown, "box": list(q.box),
        })  # fmt: skip
    return rows


def _places(
    scene: Scene, image: int, truths: Sequence[GroundTruth], targets: Targets
) -> list[tuple[Box, str]]:
    """Disturbed boxes of the visible objects, with their names."""
    camera = scene.frame(image).camera
    places = []
    for truth in truths:
        model = targets.model_of(truth)
        if model is None or truth.T_cam_obj is None or not truth.visible:
            continue
        box = truth_box(truth, model.mesh, camera)
        if box is None:
            continue
        box = disturbed(box, "perturbed", 0, scene.name, image, truth.instance, camera)
        if box.area > 0:
            places.append((box, model.name))
    return places


def read_absent(path: Path | str) -> Judged:
    """All rows of absent objects, found or not: none is right. Raises InputError."""
    rows, false = read_rows(path)
    return judged([], [row for row in [*rows, *false] if row.get("terms") is not None], path)


def main(words: Sequence[str] | None = None) -> None:
    """Ask all questions; print how often a pose is found and how often it is acquired."""
    parser = argparse.ArgumentParser(description="How often an absent object is found.")
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--objects", nargs="+", default=None, metavar="ID")
    parser.add_argument("--method", choices=("full", "colorpair"), default="full")
    arguments = parser.parse_args(words)
    models = load_models(arguments.bundles)
    targets = Targets(models, arguments.objects)
    asked = list(questions([BopScene(path) for path in arguments.bop], targets))
    estimator = Estimator(models, EstimatorConfig(method=arguments.method))
    estimator.warm_up([model.name for model in targets.models])
    rows = answers_where_absent(estimator, asked)
    lines = []
    for name, chosen in (
        ("box of another object", [row for row in rows if row["shown"] != NOTHING]),
        ("random box", [row for row in rows if row["shown"] == NOTHING]),
        ("all", rows),
    ):
        found = [row["found"] for row in chosen]
        acquired = [row["state"] == "TRACKING" for row in chosen]
        lines.append([name, len(chosen), 100.0 * np.mean(found), 100.0 * np.mean(acquired)])
    write_json(arguments.json, {"rows": rows})
    print(table(["absent object asked for in", "n", "found %", "acquired %"], lines))


if __name__ == "__main__":
    main()
