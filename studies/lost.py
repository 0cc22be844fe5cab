"""How far do visible objects get that are not found: is nothing proposed there, or is the pose not believed?

    .venv/bin/python -m studies.lost --bop SCENE... --bundles DIR

All objects are asked for in all frames, as by `huepose eval perception`. Each visible label that is not
found is looked at again in its true box, without a detector: if it is not believed even there, no proposal
would help.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from huepose.datasets.bop import BopScene
from huepose.datasets.boxes import truth_box
from huepose.datasets.types import GroundTruth, Sample
from huepose.estimation import Estimator, ObjectQuery, PoseEstimate
from huepose.estimation.config import StandingConfig
from huepose.estimation.standing import chance, standing_answers
from huepose.evaluation.estimate_protocol import PoseEstimator
from huepose.evaluation.metrics import RECALL_FRACTION
from huepose.evaluation.perception_protocol import SAME
from huepose.evaluation.summary import table
from huepose.evaluation.targets import Targets
from huepose.geometry.box import Box
from huepose.model import ReferenceModel, load_models
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.types import Detection, Detector
from huepose.profiles import profile
from huepose.support.progress import progress


class Stage(Enum):
    """How far a label gets."""

    FOUND = "found"
    COVERED = "believed, but another object explains the surface better"
    DOUBTED = "a pose is there, not believed"
    ASTRAY = "proposed, but the pose lies elsewhere"
    UNSEEN = "no proposal"


@dataclass(frozen=True)
class InItsBox:
    """A label looked at in its true box. near: the pose has an ADD-S under a tenth of the diameter; found: it
    explains what the label's box shows, and it is believed."""

    near: bool
    found: bool


@dataclass(frozen=True)
class Lost:
    """How far a label got; and in its true box, None where it was found anyway."""

    stage: Stage
    boxed: InItsBox | None


def stage_of(
    name: str,
    box: Box,
    detections: Sequence[Detection],
    answers: Sequence[PoseEstimate],
    config: StandingConfig | None = None,
) -> Stage:
    """How far the label of an object with this box got. detections: of the frame; answers: at these."""
    config = config or StandingConfig()
    there = [_shows(a, name, box) for a in answers]
    if any(_shows(a, name, box) for a in standing_answers(answers, config)):
        return Stage.FOUND
    if any(there):
        likeliest = max(chance(a) for a, here in zip(answers, there, strict=True) if here)
        return Stage.COVERED if likeliest >= config.present else Stage.DOUBTED
    proposed = any(d.object == name and d.box.iou(box) >= SAME for d in detections)
    return Stage.ASTRAY if proposed else Stage.UNSEEN


def _shows(answer: PoseEstimate, name: str, box: Box) -> bool:
    """Whether what the pose explains is what this box of the object shows."""
    own = None if answer.mask is None else Box.of_mask(answer.mask)
    return answer.object == name and own is not None and own.iou(box) >= SAME


@dataclass(frozen=True, eq=False)
class Looking:
    """What finds objects, and says whether they are there."""

    targets: Targets
    detector: Detector
    estimator: PoseEstimator

    def lost(self, sample: Sample) -> list[Lost]:
        """Of each visible label of a frame."""
        detections = self.detector.detect(sample.frame, [m.name for m in self.targets.models])
        queries = [
            ObjectQuery(d.object, box=d.box, instance=i, searched=True) for i, d in enumerate(detections)
        ]
        answers = self.estimator.estimate(sample.frame, queries) if queries else []
        out = []
        for truth in sample.truths:
            model = self.targets.model_of(truth)
            box = None if model is None else truth_box(truth, model.mesh, sample.frame.camera)
            if model is None or box is None or not truth.visible or not self.targets.wants(truth):
                continue
            stage = stage_of(model.name, box, detections, answers)
            out.append(Lost(stage, None if stage is Stage.FOUND else self._boxed(sample, truth, model, box)))
        return out

    def _boxed(self, sample: Sample, truth: GroundTruth, model: ReferenceModel, box: Box) -> InItsBox:
        answers = self.estimator.estimate(sample.frame, [ObjectQuery(model.name, box=box, searched=True)])
        believed = chance(answers[0]) >= StandingConfig().present
        T = answers[0].T_cam_obj
        near = (
            T is not None
            and truth.T_cam_obj is not None
            and self.targets.error(model, T, truth.T_cam_obj).adds_m < RECALL_FRACTION * model.diameter_m
        )
        return InItsBox(near, believed and _shows(answers[0], model.name, box))


def report(labels: Sequence[Lost]) -> str:
    """A row for each stage, and what the true box would change."""
    rows: list[list[object]] = []
    for stage in Stage:
        boxed = [x.boxed for x in labels if x.stage is stage]
        tried = [b for b in boxed if b is not None]
        near, found = sum(b.near for b in tried), sum(b.found for b in tried)
        rows.append([stage.value, len(boxed), near if tried else None, found if tried else None])
    first = sum(x.stage is Stage.FOUND for x in labels)
    more = sum(x.boxed is not None and x.boxed.found for x in labels)
    share = 100.0 / max(len(labels), 1)
    return (
        table(["label", "n", "in its true box: pose near", "found"], rows)
        + f"\nfound {share * first:.1f} % of {len(labels)}; "
        + f"with the true boxes of the others {share * (first + more):.1f} %"
    )


def looking(models: Mapping[str, ReferenceModel], objects: Sequence[str] | None) -> Looking:
    """With the settings of a live pipeline."""
    targets, settings = Targets(models, objects), profile("live")
    asked = {m.name: m for m in targets.models}
    estimator = Estimator(asked, replace(settings.estimator, found_level=0.0))
    detector = ColorPairDetector(asked, settings.detector)
    return Looking(targets, detector, estimator)


def main(words: Sequence[str] | None = None) -> None:
    """Look, and print the table."""
    parser = argparse.ArgumentParser(description="How far visible objects get that are not found.")
    parser.add_argument("--bop", type=Path, nargs="+", required=True, metavar="SCENE_DIR")
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR")
    parser.add_argument("--objects", nargs="+", default=None, metavar="ID")
    arguments = parser.parse_args(words)
    look = looking(load_models(arguments.bundles), arguments.objects)
    images = [(scene, image) for scene in map(BopScene, arguments.bop) for image in scene.image_ids]
    print(report([x for s, i in progress(images, "frames") for x in look.lost(Sample.of(s, i))]))


if __name__ == "__main__":
    main()
