"""The places of colour pairs in the full method, measured on sets of labelled scenes.

Boxes are disturbed true ones, masks the embedded segmenter's. All places answer the same questions: one
label in one disturbed box. What was answered before is not asked again, so that a long study may be stopped
and gone on with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from huepose.datasets.boxes import disturbed, truth_box
from huepose.datasets.types import GroundTruth, Scene
from huepose.estimation.prepared import PreparedModels
from huepose.evaluation.colorpairs.place_answers import Ended, shared_of
from huepose.evaluation.colorpairs.places import places_of
from huepose.evaluation.equivalents import Key
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.embedded import DepthSegmenter
from huepose.support.progress import progress


@dataclass(frozen=True)
class StudySet:
    """Scenes of which figures are given together, with their models. seeds: of the disturbed boxes; every:
    only one in so many images."""

    name: str
    scenes: Sequence[Scene]
    targets: Targets
    equivalents: Mapping[Key, Sequence[Float64]] = field(default_factory=dict)
    seeds: Sequence[int] = (0,)
    every: int = 1


@dataclass(frozen=True)
class PlaceRow:
    """What one place answered: errors (inf for no pose), quality, CPU seconds for this object."""

    add_m: float
    adds_m: float
    quality: float
    seconds: float


@dataclass(frozen=True)
class Question:
    """One label in one disturbed box, and the answers of all places by name."""

    set: str
    scene: str
    image: int
    instance: int
    object: str
    seed: int
    diameter_m: float
    answers: Mapping[str, PlaceRow]

    @property
    def key(self) -> tuple[str, str, int, int, int]:
        """What makes it this question."""
        return self.set, self.scene, self.image, self.instance, self.seed


def study_places(
    sets: Sequence[StudySet],
    min_visib: float,
    wanted: Sequence[str] | None = None,
    known: Sequence[Question] = (),
    keep: Callable[[Sequence[Question]], None] = lambda questions: None,
) -> list[Question]:
    """Answers of all places, or of `wanted` kinds of them, to every label that is wanted and visible enough.

    known: what was answered before, returned with the rest; keep: gets all questions after every frame."""
    done = {question.key for question in known}
    questions = list(known)
    frames = [(s, scene, image) for s in sets for scene in s.scenes for image in scene.image_ids[:: s.every]]
    asked: dict[str, _Asked] = {}
    for one, scene, image in progress(frames, "frames"):
        labels = [t for t in scene.truths(image) if _counts(t, one.targets, min_visib)]
        open_ones = [
            (truth, seed)
            for truth in labels
            for seed in one.seeds
            if (one.name, scene.name, image, truth.instance, seed) not in done
        ]
        if not open_ones:
            continue
        now = asked.setdefault(one.name, _Asked(one, wanted))
        frame = scene.frame(image)
        for truth, seed in open_ones:
            questions += now.ask(frame, truth, (scene.name, image, truth.instance), seed)
        keep(questions)
    return questions


class _Asked:
    """Asks the questions of one set."""

    def __init__(self, one: StudySet, wanted: Sequence[str] | None) -> None:
        self._set, self._wanted = one, wanted
        self._prepared, self._segmenter = PreparedModels(one.targets.models_by_name), DepthSegmenter()
        self._warm = False

    def ask(self, frame: RgbdFrame, truth: GroundTruth, key: Key, seed: int) -> Iterator[Question]:
        """The question, or none where nothing of the label is in the image."""
        model = self._set.targets.model_of(truth)
        if model is None:
            return
        if not self._warm:  # Kernels are compiled or read, which is not to be counted.
            self._warm = True
            dict(self._answers(frame, truth, model, key, seed))
        answers = {}
        pose, equivalents = np.asarray(truth.T_cam_obj, np.float64), self._set.equivalents.get(key, ())
        for place, ended in self._answers(frame, truth, model, key, seed):
            error = self._set.targets.error(model, ended.T_cam_obj, pose, equivalents)
            answers[place] = PlaceRow(error.add_m, error.adds_m, ended.quality, ended.seconds)
        if answers:
            yield Question(self._set.name, *key, model.name, seed, model.diameter_m, answers)

    def _answers(
        self, frame: RgbdFrame, truth: GroundTruth, model: ReferenceModel, key: Key, seed: int
    ) -> Iterator[tuple[str, Ended]]:
        """Each place with its answer and the CPU seconds that it took."""
        camera = frame.camera
        box = truth_box(truth, model.mesh, camera)
        if box is None:
            return
        box = disturbed(box, "perturbed", seed, *key, camera.width, camera.height)
        table = self._prepared.prepared(model.name).table
        shared = shared_of(frame, box, model, table, self._segmenter, (seed, *key[1:]))
        if shared is None:
            return
        for place, found in places_of(shared, self._wanted).items():
            ended = shared.ended(found.poses, found.totals, found.weight, found.method, found.edges)
            yield place, Ended(ended.T_cam_obj, ended.quality, found.seconds + ended.seconds)


def _counts(truth: GroundTruth, targets: Targets, min_visib: float) -> bool:
    seen = truth.shows(min_visib)
    return seen and targets.wants(truth) and truth.T_cam_obj is not None
