"""An object is taken away before a camera that stands still: what is TRACKING then, and when it is back?

    .venv/bin/python -m studies.gone --bop SCENE... --bundles DIR --json OUT.json

Each object that stands alone of its kind and is seen nearly whole is tracked for a second, covered for one,
gone for five (there is then what lies beside it), and back for three. Perception is that of a live pipeline,
and knows this one object. It and the tracker look for it all the time, so whatever looks like it will be
found.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import TypeVar

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.datasets.boxes import truth_box
from huepose.datasets.types import GroundTruth
from huepose.estimation import Estimator, PoseEstimate
from huepose.evaluation.result_files import write_json
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Rng
from huepose.judge.open_region import PreparedSurface
from huepose.model import ReferenceModel, load_models
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.reinit.looking import Looks, query_of
from huepose.reinit.types import Request
from huepose.support.progress import progress
from huepose.tracking import Tracker
from studies.stress.films import Seen
from studies.stress.play import play

R = TypeVar("R")

NEARLY_WHOLE = 0.8
"""Least share of an object that is seen, for it to be taken away."""

SECONDS_SEEN, SECONDS_COVERED, SECONDS_GONE, SECONDS_BACK, HZ = 1, 1, 5, 3, 15
PARTS_S = tuple(accumulate((SECONDS_SEEN, SECONDS_COVERED, SECONDS_GONE, SECONDS_BACK)))
"""When each part ends; frames in a second."""

NEARER_M, GRAY = 0.3, 128
"""What covers it is flat and gray, so much nearer than the scene is at the median."""

AROUND, BESIDE = 0.08, 5
"""What is taken away is its box, grown by that share; what is put there is as far beside it, pixels."""

COLOR_NOISE, DEPTH_NOISE_PER_M = 2.5, 0.0012
"""Of each frame: grey levels, and metres at one metre, growing with its square."""

TOLD_IN = 5
"""So many frames after it is covered its pose may still be TRACKING."""


@dataclass(frozen=True)
class Row:
    """Of one object of one frame. frames, false: while it is not there, those that are counted, and those in
    which something is TRACKING; back, right, wrong: the same of it being back, TRACKING and right, TRACKING
    and not."""

    scene: str
    image: int
    object: str
    frames: int
    false: int
    back: int
    right: int
    wrong: int


class Sight:
    """Perception of a live pipeline before a camera that stands still, which knows these objects."""

    def __init__(self, *models: ReferenceModel) -> None:
        live, known = profile("live"), {model.name: model for model in models}
        surfaces = {name: PreparedSurface.of(model) for name, model in known.items()}
        detector = ViewDetector(known, replace(live.detector, remembering=True))
        self._looks = Looks(detector, lambda name, T, camera: surfaces[name].box(T, camera))
        self._estimator = Estimator(known, live.estimator)

    def answer(self, request: Request, seen: Seen) -> list[PoseEstimate]:
        """Estimates of what was asked for, where a detector worker would look."""
        frame = seen.frame
        places = self._looks.places(frame, request.objects, request.waiting)
        return self._estimator.estimate(
            frame,
            [
                query_of(asked, place.box, frame.stamp_ns)
                for asked, mine in zip((*request.objects, *request.waiting), places, strict=True)
                for place in mine
            ],
        )


def shown(frame: RgbdFrame, number: int, rng: Rng) -> RgbdFrame:
    """A frame as a camera shows it again: that number of a film, with noise of its own."""
    color = frame.color + rng.standard_normal(frame.color.shape, np.float32) * COLOR_NOISE
    depth = (
        frame.depth + rng.standard_normal(frame.depth.shape, np.float32) * DEPTH_NOISE_PER_M * frame.depth**2
    )
    color = np.clip(np.rint(color), 0, 255).astype(np.uint8)
    return RgbdFrame(color, depth.astype(np.float32), frame.camera, number, round(number * 1e9 / HZ))


Part = tuple[slice, slice]
"""Rows and columns of a picture."""


def part_and_beside(
    frame: RgbdFrame, label: GroundTruth, model: ReferenceModel, rng: Rng
) -> tuple[Part, Part] | None:
    """The part of a frame with an object, and as large a part beside it; None where there is none."""
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


def film(frame: RgbdFrame, label: GroundTruth, model: ReferenceModel, rng: Rng) -> list[Seen]:
    """An object of a frame that is seen, covered, gone, and back; empty where nothing of its size is beside
    it."""
    parts, T_cam_obj = part_and_beside(frame, label, model, rng), label.T_cam_obj
    if parts is None or T_cam_obj is None:
        return []
    hole, beside = parts
    covered, gone, back, end = (HZ * seconds for seconds in PARTS_S)
    out = []
    for number in range(end):
        color, depth = frame.color.copy(), frame.depth.copy()
        if gone <= number < back:
            color[hole], depth[hole] = (m[beside] for m in (frame.color, frame.depth))
        elif covered <= number < gone:
            color[hole], depth[hole] = GRAY, max(float(np.median(depth[depth > 0])) - NEARER_M, 0.2)
        noisy = shown(replace(frame, color=color, depth=depth), number, rng)
        out.append(Seen(noisy, T_cam_obj, 0.0 if covered <= number < back else 1.0))
    return out


def images_of(scene: BopScene, most: int) -> list[int]:
    """At most so many frames of a scene, spread evenly."""
    return list(scene.image_ids[:: -(-len(scene.image_ids) // most)])


def rows(scene: BopScene, targets: Targets, most: int, seed: int) -> Iterator[Row]:
    """All objects that can be taken away, of at most so many frames of a scene, spread evenly."""
    for image in images_of(scene, most):
        frame, labels = scene.frame(image), scene.truths(image)
        kinds = [label.object_id for label in labels]
        for label in labels:
            model = targets.model_of(label)
            if model is None or (label.visib_fract or 0.0) < NEARLY_WHOLE or kinds.count(label.object_id) > 1:
                continue
            rng = np.random.default_rng([seed, image, label.object_id or 0])
            frames = film(frame, label, model, rng)
            if not frames:
                continue
            tracker = Tracker({model.name: model}, profile("live").tracker)
            told = play(frames, model, tracker, frames[0].T_cam_obj, perception=Sight(model))
            covered, _, back, _ = (HZ * seconds for seconds in PARTS_S)
            away, again = told[covered + TOLD_IN : back], told[back:]
            right = [t.right for t in again if t.state == State.TRACKING.value]
            false = sum(t.state == State.TRACKING.value for t in away)
            counts = len(away), false, len(again), sum(right), len(right) - sum(right)
            yield Row(scene.name, image, model.name, *counts)


def parser_of(what: str | None) -> argparse.ArgumentParser:
    """The command line of a study that plays films of the frames of scenes."""
    parser = argparse.ArgumentParser(description=what, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bop", type=Path, nargs="+", required=True)
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--images", type=int, default=6, help="of each scene (6)")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def filmed(arguments: argparse.Namespace, rows_of: Callable[[BopScene], Iterable[R]]) -> list[R]:
    """The rows (dataclasses) of all scenes; they are written after each."""
    done: list[R] = []
    for scene in progress([BopScene(path) for path in arguments.bop], "scenes"):
        done += rows_of(scene)
        write_json(arguments.json, {"rows": [vars(row) for row in done]})
    return done


def main() -> None:
    """Take away all objects of the scenes, one by one."""
    arguments = parser_of(__doc__).parse_args()
    targets = Targets(load_models(arguments.bundles))
    done = filmed(arguments, lambda scene: rows(scene, targets, arguments.images, arguments.seed))
    for row in done:
        if row.false or row.wrong:
            print(
                f"{row.scene} {row.image} {row.object}: {row.false} of {row.frames}, back {row.wrong} wrong"
            )
    frames, false, back, right, wrong = (
        sum(getattr(row, name) for row in done) for name in ("frames", "false", "back", "right", "wrong")
    )
    films = sum(row.false > 0 for row in done)
    print(f"not there: false TRACKING in {false} of {frames} frames, in {films} of {len(done)} films")
    print(f"back: TRACKING and right in {right} of {back} frames, wrong in {wrong}")


if __name__ == "__main__":
    main()
