"""A camera that stands still, and one object that is known: is it found, and is anything else taken for it?

    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json [--strangers]

Each object that stands alone of its kind in a frame is looked for, and some that are not there. Perception
is that of a live pipeline, and knows this one object, for six seconds. What is not there and not found by a
first look, with a quality of 0.1, is watched no further.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64, Rng
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.types import Request, RequestedObject
from huepose.tracking import Tracker
from studies.gone import HZ, Sight, filmed, parser_of, shown
from studies.stress.films import Seen
from studies.stress.play import play

SECONDS, LEAST = 6, 0.1

NOWHERE = np.full((4, 4), np.inf)
"""The true pose of what is not there: nothing is near it."""


@dataclass(frozen=True)
class Row:
    """Of one object of one frame. there: whether it is; frames: of the film; right, wrong: those in which it
    is TRACKING and right, or not right; first_s: when it was first TRACKING and right, None if never."""

    scene: str
    image: int
    object: str
    there: bool
    frames: int
    right: int
    wrong: int
    first_s: float | None


def watched(frame: RgbdFrame, model: ReferenceModel, truth: Float64 | None, rng: Rng) -> tuple[int, ...]:
    """Of each frame of a film of this one: 1 where the object is TRACKING and right, -1 where it is TRACKING
    and not. truth: its pose (4, 4), None where it is not there."""
    T_cam_obj, share = (NOWHERE, 0.0) if truth is None else (truth, 1.0)
    frames = [Seen(shown(frame, n, rng), T_cam_obj, share) for n in range(HZ * SECONDS)]
    tracker = Tracker({model.name: model}, profile("live").tracker)
    told = play(frames, model, tracker, None, perception=Sight(model))
    return tuple(0 if t.state != State.TRACKING.value else 1 if t.right else -1 for t in told)


def likely(frame: RgbdFrame, model: ReferenceModel) -> bool:
    """Whether a first look finds an object, be it there or not."""
    seen = Seen(frame, NOWHERE, 0.0)
    request = Request(1, None, 0, (RequestedObject(model.name, None),))
    return any(answer.found and answer.quality >= LEAST for answer in Sight(model).answer(request, seen))


def rows(
    scene: BopScene, models: dict[str, ReferenceModel], strangers: bool, most: int, absent: int, seed: int
) -> Iterator[Row]:
    """Of at most so many frames of a scene, spread evenly. strangers: none of the objects is in it, whatever
    its labels say; absent: so many that are not in the frame are looked for, chosen at random."""
    targets = Targets(models)
    for image in scene.image_ids[:: -(-len(scene.image_ids) // most)]:
        frame, labels = scene.frame(image), [] if strangers else scene.truths(image)
        named = [(model.name, label) for label in labels if (model := targets.model_of(label)) is not None]
        kinds = [name for name, _ in named]
        rng = np.random.default_rng([seed, image])
        asked = [(n, label.T_cam_obj) for n, label in named if label.visible and kinds.count(n) == 1]
        away = rng.permutation(sorted(set(models) - set(kinds)))[:absent]
        for name, truth in [*asked, *((str(n), None) for n in away)]:
            if truth is None and not likely(frame, models[name]):
                yield Row(scene.name, image, name, False, HZ * SECONDS, 0, 0, None)
                continue
            told = watched(frame, models[name], truth, rng)
            first = told.index(1) / HZ if 1 in told else None
            counts = len(told), told.count(1), told.count(-1), first
            yield Row(scene.name, image, name, truth is not None, *counts)


def report(done: Sequence[Row]) -> str:
    """What became of those that are there, and of those that are not."""
    there, away = [r for r in done if r.there], [r for r in done if not r.there]
    frames, right, wrong = (sum(getattr(r, name) for r in there) for name in ("frames", "right", "wrong"))
    soon = sum(r.first_s is not None and r.first_s <= 2.0 for r in there)
    false, gone = sum(r.wrong for r in away), sum(r.frames for r in away)
    films = sum(r.wrong > 0 for r in away)
    return (
        f"there: {soon} of {len(there)} TRACKING and right within 2 s; "
        f"right in {right} of {frames} frames, wrong in {wrong}\n"
        f"not there: false TRACKING in {false} of {gone} frames, in {films} of {len(away)} films"
    )


def main() -> None:
    """Watch all objects of the scenes, one by one."""
    parser = parser_of(__doc__)
    parser.add_argument("--strangers", action="store_true", help="none of the objects is in the scenes")
    parser.add_argument("--absent", type=int, default=3, help="objects that are not there, of each frame (3)")
    given = parser.parse_args()
    models = dict(load_models(given.bundles))
    done = filmed(
        given, lambda scene: rows(scene, models, given.strangers, given.images, given.absent, given.seed)
    )
    for row in done:
        if row.wrong:
            print(f"{row.scene} {row.image} {row.object}: {row.wrong} of {row.frames} wrong")
    print(report(done))


if __name__ == "__main__":
    main()
