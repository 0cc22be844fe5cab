"""What studies of a live pipeline share: its perception, films of a fixed camera made from one recorded
frame, the objects in the frame, and the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from huepose.datasets.bop import BopScene
from huepose.datasets.boxes import truth_box
from huepose.datasets.types import GroundTruth
from huepose.estimation import Estimator, PoseEstimate
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64, Rng
from huepose.judge.open_region import PreparedSurface
from huepose.model import ReferenceModel
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.reinit.looking import Looks, query_of
from huepose.reinit.types import Request
from huepose.support.progress import progress
from studies.stress.films import Seen

R = TypeVar("R")

HZ = 15
"""Frame rate of a film."""

NOWHERE = np.full((4, 4), np.inf)
"""Stands for the true pose in a film: only the oracle of `studies.stress` reads it."""

AROUND, BESIDE = 0.08, 5
"""An object's box, grown by this share, is replaced by a part of the image this many pixels beside it."""

COLOR_NOISE, DEPTH_NOISE_PER_M = 2.5, 0.0012
"""Standard deviations of the noise of each frame: grey levels; metres at one metre, growing with the square
of the depth."""


class Sight:
    """Perception of a live pipeline with a fixed camera, which knows these objects."""

    def __init__(self, *models: ReferenceModel) -> None:
        live, known = profile("live"), {model.name: model for model in models}
        self._surfaces = {name: PreparedSurface.of(model) for name, model in known.items()}
        detector = ViewDetector(known, replace(live.detector, remembering=True))
        self._looks = Looks(detector, self._surfaces)
        self._estimator = Estimator(known, live.estimator)

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """Estimates of the requested objects, where a detector worker would search."""
        frame = seen.frame
        places = self._looks.places(frame, request.objects, request.waiting)
        return self._estimator.estimate(
            frame,
            [
                query_of(asked, place.box, frame.stamp_ns, self._surfaces[asked.object].middle_obj)
                for asked, mine in zip((*request.objects, *request.waiting), places, strict=True)
                for place in mine
            ],
        )


def shown(frame: RgbdFrame, number: int, rng: Rng) -> RgbdFrame:
    """The frame `number` of a film: the given frame with new noise."""
    color = frame.color + rng.standard_normal(frame.color.shape, np.float32) * COLOR_NOISE
    depth = (
        frame.depth + rng.standard_normal(frame.depth.shape, np.float32) * DEPTH_NOISE_PER_M * frame.depth**2
    )
    color = np.clip(np.rint(color), 0, 255).astype(np.uint8)
    return RgbdFrame(color, depth.astype(np.float32), frame.camera, number, round(number * 1e9 / HZ))


Part = tuple[slice, slice]
"""Rows and columns of an image."""


def part_and_beside(
    frame: RgbdFrame, label: GroundTruth, model: ReferenceModel, rng: Rng
) -> tuple[Part, Part] | None:
    """The part of a frame with an object, and a part of the same size beside it; None if there is none."""
    box = truth_box(label, model.mesh, frame.camera)
    if box is None:
        return None
    here = box.grown(AROUND).clipped(frame.camera.width, frame.camera.height)
    x, y, w, h = int(here.x), int(here.y), int(here.w), int(here.h)
    places = [(x + w + BESIDE, y), (x - w - BESIDE, y), (x, y - h - BESIDE), (x, y + h + BESIDE)]
    rows, columns = frame.depth.shape
    places = [(a, b) for a, b in places if 0 <= a <= columns - w and 0 <= b <= rows - h]
    if not places or w < 1 or h < 1:
        return None
    a, b = places[int(rng.integers(len(places)))]
    return (slice(y, y + h), slice(x, x + w)), (slice(b, b + h), slice(a, a + w))


Instance = tuple[Float64, bool]
"""Pose T_cam_obj (4, 4), and whether the instance is visible."""


def kinds_of(labels: Sequence[GroundTruth], targets: Targets) -> dict[str, list[Instance]]:
    """The instances of the known objects, by name."""
    kinds: dict[str, list[Instance]] = {}
    for label in labels:
        model = targets.model_of(label)
        if model is not None and label.T_cam_obj is not None:
            kinds.setdefault(model.name, []).append((label.T_cam_obj, label.visible))
    return kinds


def images_of(scene: BopScene, most: int) -> list[int]:
    """At most `most` frames of a scene, spread evenly."""
    return list(scene.image_ids[:: -(-len(scene.image_ids) // most)])


class Alone(NamedTuple):
    """An object with one instance in a frame; kinds: all instances in the frame; rng: for this object."""

    image: int
    frame: RgbdFrame
    label: GroundTruth
    model: ReferenceModel
    kinds: Mapping[str, Sequence[Instance]]
    rng: Rng


def alone_in(
    scene: BopScene, targets: Targets, given: argparse.Namespace, least_visible: float
) -> Iterator[Alone]:
    """The objects with one instance whose visible share is at least `least_visible`, in at most
    `given.images` frames of a scene."""
    for image in images_of(scene, given.images):
        frame, labels = scene.frame(image), scene.truths(image)
        kinds = kinds_of(labels, targets)
        for label in labels:
            model = targets.model_of(label)
            if model is None or (label.visib_fract or 0.0) < least_visible or len(kinds[model.name]) > 1:
                continue
            rng = np.random.default_rng([given.seed, image, label.object_id or 0])
            yield Alone(image, frame, label, model, kinds, rng)


def parser_of(what: str | None) -> argparse.ArgumentParser:
    """The command line of a study that plays films made from the frames of scenes."""
    parser = argparse.ArgumentParser(description=what, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bop", type=Path, nargs="+", required=True)
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--images", type=int, default=6, help="frames of each scene (6)")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def filmed(arguments: argparse.Namespace, rows_of: Callable[[BopScene], Iterable[R]]) -> list[R]:
    """The rows (dataclasses) of all scenes; they are written after each."""
    done: list[R] = []
    for scene in progress([BopScene(path) for path in arguments.bop], "scenes"):
        done += rows_of(scene)
        write_json(arguments.json, {"rows": [vars(row) for row in done]})
    return done
