"""Asking for objects where they are not: in the boxes of other objects, and where nothing special is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from huepose.datasets.boxes import disturbed, truth_box
from huepose.datasets.types import GroundTruth, Scene
from huepose.estimation.estimator import Estimator
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.evaluation.targets import Targets, object_number
from huepose.geometry.box import Box
from huepose.model.types import ReferenceModel
from huepose.support.progress import progress

NOTHING = "nothing"

LEAST_VISIBLE = 0.3
"""Share of an object that is seen in the box of which others are asked for."""


@dataclass(frozen=True, eq=False)
class Question:
    """An object that is not in the image, and the box in which it is asked for; shown: the object whose box
    it is, or NOTHING where the box was put anywhere."""

    scene: Scene
    image: int
    number: int
    model: ReferenceModel
    box: Box
    shown: str


def questions(scenes: Sequence[Scene], targets: Targets, per_frame: int, seed: int = 0) -> Iterator[Question]:
    """`per_frame` a frame, the last of them in a box put anywhere; of objects that have no label in it."""
    rng = np.random.default_rng([seed, 41])
    for scene in scenes:
        for image in scene.image_ids:
            truths = scene.truths(image)
            here = {model.name for t in truths if (model := targets.model_of(t)) is not None}
            away = [model for model in targets.models if model.name not in here]
            places = _places(scene, image, truths, targets) if away else []
            for number in range(per_frame if places else 0):
                model = away[rng.integers(len(away))]
                box, shown = places[rng.integers(len(places))]
                if number == per_frame - 1:
                    camera = scene.frame(image).camera
                    x = rng.uniform(0.0, max(1.0, camera.width - box.w))
                    y = rng.uniform(0.0, max(1.0, camera.height - box.h))
                    box, shown = Box(x, y, box.w, box.h).clipped(camera.width, camera.height), NOTHING
                yield Question(scene, image, number, model, box, shown)


def answers_where_absent(estimator: Estimator, asked: Sequence[Question]) -> list[dict[str, Any]]:
    """Rows as those of `huepose eval estimate`, none of them right, of questions that are asked alone."""
    rows = []
    for q in progress(asked, "absent"):
        answer, _ = estimator.explain(q.scene.frame(q.image), ObjectQuery(q.model.name, q.box))
        rows.append({**_row(answer, q.model), "scene": q.scene.name, "image": q.image,
                     "instance": q.number, "shown": q.shown, "box": list(q.box)})  # fmt: skip
    return rows


def _row(answer: PoseEstimate, model: ReferenceModel) -> dict[str, Any]:
    return {
        "object": object_number(model),
        "found": answer.found,
        "right": False,
        "quality": answer.quality,
        "state": answer.state,
        "terms": None if answer.terms is None else asdict(answer.terms),
    }


def _places(
    scene: Scene, image: int, truths: Sequence[GroundTruth], targets: Targets
) -> list[tuple[Box, str]]:
    """Disturbed boxes of what is seen, with its name."""
    camera = scene.frame(image).camera
    places = []
    for truth in truths:
        model = targets.model_of(truth)
        if model is None or truth.T_cam_obj is None or not truth.shows(LEAST_VISIBLE):
            continue
        box = truth_box(truth, model.mesh, camera)
        if box is None:
            continue
        box = disturbed(box, "perturbed", 0, scene.name, image, truth.instance, camera.width, camera.height)
        if box.area > 0:
            places.append((box, model.name))
    return places
