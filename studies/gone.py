"""An object is taken away before a fixed camera: what is TRACKING then, and when it is back?

    .venv/bin/python -m studies.gone --bop SCENE... --bundles DIR --json OUT.json

Each object that has one instance in a frame and is nearly completely visible is tracked for a second, covered
for one, gone for five (its place then shows the part of the image beside it), and back for three. Perception
is that of a live pipeline, and knows only this object. Perception and the tracker search for it all the time,
so that look-alikes are found.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.datasets.types import GroundTruth
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Rng
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.tracking import Tracker
from studies.live import HZ, Sight, alone_in, filmed, parser_of, part_and_beside, shown
from studies.stress.films import Seen
from studies.stress.play import play

NEARLY_WHOLE = 0.8
"""Least visible share of an object that is taken away."""

PARTS_S = tuple(accumulate((1, 1, 5, 3)))
"""When each part of a film ends: visible, covered, gone, back."""

NEARER_M, GRAY = 0.3, 128
"""The cover is flat and grey, and nearer than the median depth of the scene by this distance."""

ALLOWED = 5
"""Number of frames after an object is covered in which its pose may still be TRACKING."""


@dataclass(frozen=True)
class Row:
    """Result of one object in one frame. frames, false: while it is covered or gone, the frames that are
    counted, and those with a pose that is TRACKING; back, right, wrong: the frames after it is back, and
    those with a pose that is TRACKING and right, or wrong."""

    scene: str
    image: int
    object: str
    frames: int
    false: int
    back: int
    right: int
    wrong: int


def film(frame: RgbdFrame, label: GroundTruth, model: ReferenceModel, rng: Rng) -> list[Seen]:
    """A film of an object that is visible, covered, gone, and back; empty if there is no part of its size
    beside it."""
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


def rows(scene: BopScene, targets: Targets, given: argparse.Namespace) -> Iterator[Row]:
    """The rows of all suitable objects in at most `given.images` frames of a scene."""
    for image, frame, label, model, _, rng in alone_in(scene, targets, given, NEARLY_WHOLE):
        frames = film(frame, label, model, rng)
        if not frames:
            continue
        tracker = Tracker({model.name: model}, profile("live").tracker)
        moments = play(frames, model, tracker, frames[0].T_cam_obj, perception=Sight(model))
        covered, _, back, _ = (HZ * seconds for seconds in PARTS_S)
        away, again = moments[covered + ALLOWED : back], moments[back:]
        right = [m.right for m in again if m.state == State.TRACKING.value]
        false = sum(m.state == State.TRACKING.value for m in away)
        counts = len(away), false, len(again), sum(right), len(right) - sum(right)
        yield Row(scene.name, image, model.name, *counts)


def main() -> None:
    """Play the films of all scenes, one by one, and print the results."""
    arguments = parser_of(__doc__).parse_args()
    targets = Targets(load_models(arguments.bundles))
    done = filmed(arguments, lambda scene: rows(scene, targets, arguments))
    for row in done:
        if row.false or row.wrong:
            print(
                f"{row.scene} {row.image} {row.object}: {row.false} of {row.frames}, back {row.wrong} wrong"
            )
    frames, false, back, right, wrong = (
        sum(getattr(row, name) for row in done) for name in ("frames", "false", "back", "right", "wrong")
    )
    films = sum(row.false > 0 for row in done)
    print(f"covered or gone: false TRACKING in {false} of {frames} frames, in {films} of {len(done)} films")
    print(f"back: TRACKING and right in {right} of {back} frames, wrong in {wrong}")


if __name__ == "__main__":
    main()
