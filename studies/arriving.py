"""Many objects are known, and one of them is put before a camera that stands still: how soon is it TRACKING?

    .venv/bin/python -m studies.arriving --bop SCENE... --bundles DIR --json OUT.json

All kinds of the bundles are looked for, as in a live pipeline. Each object that stands alone of its kind in a
frame, and is seen nearly whole, is put there after six seconds; until then there is what lies beside it.
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
"""Visible share of what is put there, and how long the scene is seen without it."""


@dataclass(frozen=True)
class Row:
    """Of one object. found_s: when it was TRACKING and right, from when it was put there; None where it was
    not in time. absent: frames in which a kind that is not there was TRACKING; frames: of the film, as far
    as it was watched."""

    scene: str
    image: int
    object: str
    found_s: float | None
    absent: int
    frames: int


def film(frame: RgbdFrame, label: GroundTruth, model: ReferenceModel, seconds: int, rng: Rng) -> list[Seen]:
    """An object is put there; empty where nothing of its size is beside it."""
    parts = part_and_beside(frame, label, model, rng)
    if parts is None:
        return []
    (hole, beside), color, depth = parts, frame.color.copy(), frame.depth.copy()
    color[hole], depth[hole] = frame.color[beside], frame.depth[beside]
    without, count = replace(frame, color=color, depth=depth), HZ * SECONDS_BEFORE
    pictures = [without] * count + [frame] * (HZ * seconds)
    return [Seen(shown(one, number, rng), NOWHERE, 1.0) for number, one in enumerate(pictures)]


def watched(
    frames: Sequence[Seen], models: Mapping[str, ReferenceModel], there: Mapping[str, Float64], name: str
) -> tuple[float | None, int, int]:
    """What is seen of a film until the object is TRACKING and right, as the last fields of a row. there: the
    true poses (4, 4) of the kinds that the scene shows, or a pose of each."""
    tracker = Tracker(models, profile("live").tracker)
    loop = ReinitLoop(objects=[ObjectSlot.of(model) for model in models.values()])
    absent = number = 0
    for number, (_, poses) in enumerate(followed(frames, tracker, loop, Sight(*models.values()))):
        sure = [pose for pose in poses if pose.state is State.TRACKING]
        absent += any(pose.object not in there for pose in sure)
        errors = [error_of(models[name], p.T_cam_obj, there[name]) for p in sure if p.object == name]
        if number >= HZ * SECONDS_BEFORE and min(errors, default=np.inf) < metrics.RECALL_FRACTION:
            return number / HZ - SECONDS_BEFORE, absent, number + 1
    return None, absent, number + 1


def rows(scene: BopScene, models: Mapping[str, ReferenceModel], given: argparse.Namespace) -> Iterator[Row]:
    """All objects that can be put there, of at most so many frames of a scene as are given."""
    for image, frame, label, model, kinds, rng in alone_in(scene, Targets(models), given, NEARLY_WHOLE):
        frames = film(frame, label, model, given.seconds, rng)
        if frames:
            there = {name: instances[0][0] for name, instances in kinds.items()}
            found_s, absent, count = watched(frames, models, there, model.name)
            yield Row(scene.name, image, model.name, found_s, absent, count)


def report(done: Sequence[Row]) -> str:
    """How soon they were found, and how often what is not there was TRACKING."""
    times = [row.found_s for row in done if row.found_s is not None]
    at = "{:.1f} s, {:.1f} s".format(*np.percentile(times, (50, 90))) if times else "-"
    soon = ", ".join(str(sum(t <= limit for t in times)) for limit in (1.0, 2.0))
    absent, frames = sum(row.absent for row in done), sum(row.frames for row in done)
    return (
        f"{len(times)} of {len(done)} TRACKING and right, within 1 s, 2 s: {soon}; median, 90 %: {at}; "
        f"what is not there is TRACKING in {absent} of {frames} frames"
    )


def main() -> None:
    """Put all objects of the scenes there, one by one."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=int, default=6, help="to find it in (6)")
    given = parser.parse_args()
    models = load_models(given.bundles)
    done = filmed(given, lambda scene: rows(scene, models, given))
    for row in done:
        print(f"{row.scene} {row.image} {row.object}: {row.found_s}, {row.absent} of {row.frames}")
    print(report(done))


if __name__ == "__main__":
    main()
