"""Many objects are known, and one of them is put before a fixed camera: how soon is it TRACKING?

    .venv/bin/python -m studies.arriving --bop SCENE... --bundles DIR --json OUT.json

All objects of the bundles are searched for, as in a live pipeline. Each object that has one instance in a
frame and is nearly completely visible appears after six seconds; until then its place shows the part of the
image beside it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.datasets.types import GroundTruth
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64, Rng
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.tracking import Tracker
from studies.live import HZ, NOWHERE, Sight, alone_in, filmed, parser_of, part_and_beside, shown
from studies.stress.films import Seen
from studies.stress.play import error_of, followed

NEARLY_WHOLE, SECONDS_BEFORE = 0.7, 6
"""Least visible share of the object, and for how long the scene is shown without it."""


@dataclass(frozen=True)
class Row:
    """Result of one object. found_s: time from its appearance until it was TRACKING and right; None if it was
    not found in the film. absent: frames in which an absent object was TRACKING; frames: played frames."""

    scene: str
    image: int
    object: str
    found_s: float | None
    absent: int
    frames: int


def film(frame: RgbdFrame, label: GroundTruth, model: ReferenceModel, seconds: int, rng: Rng) -> list[Seen]:
    """A film in which an object appears; empty if there is no part of its size beside it."""
    parts = part_and_beside(frame, label, model, rng)
    if parts is None:
        return []
    (hole, beside), color, depth = parts, frame.color.copy(), frame.depth.copy()
    color[hole], depth[hole] = frame.color[beside], frame.depth[beside]
    without, count = replace(frame, color=color, depth=depth), HZ * SECONDS_BEFORE
    frames = [without] * count + [frame] * (HZ * seconds)
    return [Seen(shown(one, number, rng), NOWHERE, 1.0) for number, one in enumerate(frames)]


def watched(
    frames: Sequence[Seen], models: Mapping[str, ReferenceModel], there: Mapping[str, Float64], name: str
) -> tuple[float | None, int, int]:
    """Play a film until the object is TRACKING and right; returns the last fields of a row. there: the true
    pose (4, 4) of each object in the scene, of the first instance if there are several."""
    tracker = Tracker(models, profile("live").tracker)
    loop = ReinitLoop(objects=[ObjectSlot.of(model) for model in models.values()])
    absent = number = 0
    for number, (_, poses) in enumerate(followed(frames, tracker, loop, Sight(*models.values()))):
        sure = [pose for pose in poses if pose.state is State.TRACKING]
        away = number < HZ * SECONDS_BEFORE
        absent += any(pose.object not in there or (away and pose.object == name) for pose in sure)
        errors = [error_of(models[name], p.T_cam_obj, there[name]) for p in sure if p.object == name]
        if not away and min(errors, default=np.inf) < metrics.RECALL_FRACTION:
            return number / HZ - SECONDS_BEFORE, absent, number + 1
    return None, absent, number + 1


def rows(scene: BopScene, models: Mapping[str, ReferenceModel], given: argparse.Namespace) -> Iterator[Row]:
    """The rows of all suitable objects in at most `given.images` frames of a scene."""
    for image, frame, label, model, kinds, rng in alone_in(scene, Targets(models), given, NEARLY_WHOLE):
        frames = film(frame, label, model, given.seconds, rng)
        if frames:
            there = {name: instances[0][0] for name, instances in kinds.items()}
            found_s, absent, count = watched(frames, models, there, model.name)
            yield Row(scene.name, image, model.name, found_s, absent, count)


def report(done: Sequence[Row]) -> str:
    """How soon the objects were found, and how often an absent one was TRACKING, as text."""
    times = [row.found_s for row in done if row.found_s is not None]
    at = "{:.1f} s, {:.1f} s".format(*np.percentile(times, (50, 90))) if times else "-"
    soon = ", ".join(str(sum(t <= limit for t in times)) for limit in (1.0, 2.0))
    absent, frames = sum(row.absent for row in done), sum(row.frames for row in done)
    return (
        f"{len(times)} of {len(done)} TRACKING and right, within 1 s, 2 s: {soon}; median, 90 %: {at}; "
        f"an absent object is TRACKING in {absent} of {frames} frames"
    )


def main() -> None:
    """Play the films of all scenes, one by one, and print the results."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=int, default=6, help="time to find the object (6)")
    given = parser.parse_args()
    models = load_models(given.bundles)
    done = filmed(given, lambda scene: rows(scene, models, given))
    for row in done:
        print(f"{row.scene} {row.image} {row.object}: {row.found_s}, {row.absent} of {row.frames}")
    print(report(done))


if __name__ == "__main__":
    main()
