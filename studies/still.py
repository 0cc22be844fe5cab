"""A fixed camera and one known object, or many at once: is it found, and are there false positives?

    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json [--strangers]
    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json --several [--more 2]
    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json --together --seconds 8

Each object with one visible instance in a frame is searched for, and some absent objects. With `--several`
instead each object with two or more visible instances: as many as there are, plus `--more`. With `--draw`
missing scenes are rendered first: heaps of two objects of the bundles, four instances of each. Perception is
that of a live pipeline, and knows only this object. An absent object is not followed further if the first
detection does not find it with a quality of 0.1. With `--together` all objects of the bundles are known and
searched for at once, in one film.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Rng
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot, Request, RequestedObject
from huepose.scenes.rendered import write_rendered_set
from huepose.tracking import Tracker
from studies.live import HZ, NOWHERE, Instance, Sight, filmed, images_of, kinds_of, parser_of, shown
from studies.stress.films import Seen
from studies.stress.play import error_of, followed

LEAST, SOON_S = 0.1, 2.0
"""Least quality with which a first detection finds an object; an object is found soon within this time."""

KINDS, EACH = 2, 4
"""Rendered scenes: number of objects, and instances of each."""


@dataclass(frozen=True)
class Row:
    """Result of one object in one frame. there: visible instances; frames: of the film; found_s: for each
    visible instance that was found, when a pose of it was first TRACKING and right; right, wrong: number of
    poses in all frames that are TRACKING and right, or wrong; twice: of the right ones, those on an instance
    that has another; posed: poses of any state."""

    scene: str
    image: int
    object: str
    there: int
    frames: int
    found_s: tuple[float, ...]
    right: int
    wrong: int
    twice: int
    posed: int


Outcome = tuple[tuple[float, ...], int, int, int, int]
"""Of an object: `found_s` and the fields after it in a `Row`."""


def watched(
    frame: RgbdFrame,
    models: Mapping[str, ReferenceModel],
    kinds: Mapping[str, Sequence[Instance]],
    wanted: int,
    count: int,
    rng: Rng,
) -> dict[str, Outcome]:
    """The outcome for each known object in a film of `count` frames made from this one. wanted: number of
    instances of each that are searched for."""
    film = [Seen(shown(frame, n, rng), NOWHERE, 1.0) for n in range(count)]
    tracker = Tracker(models, profile("live").tracker)
    loop = ReinitLoop(objects=[ObjectSlot.of(model, wanted) for model in models.values()])
    first: dict[str, dict[int, float]] = {name: {} for name in models}
    counts = {name: Counter[str]() for name in models}
    for number, (_, poses) in enumerate(followed(film, tracker, loop, Sight(*models.values()))):
        taken: set[tuple[str, int]] = set()
        for pose in poses:
            name, counted = pose.object, counts[pose.object]
            counted["posed"] += pose.T_cam_obj is not None
            if pose.state is not State.TRACKING:
                continue
            truths = [truth for truth, _ in kinds.get(name, ())]
            errors = [error_of(models[name], pose.T_cam_obj, truth) for truth in truths]
            if min(errors, default=np.inf) >= metrics.RECALL_FRACTION:
                counted["wrong"] += 1
                continue
            k = int(np.argmin(errors))
            counted["right"] += 1
            counted["twice"] += (name, k) in taken
            taken.add((name, k))
            first[name].setdefault(k, number / HZ)
    outcomes: dict[str, Outcome] = {}
    for name, n in counts.items():
        found_s = tuple(sorted(s for k, s in first[name].items() if kinds[name][k][1]))
        outcomes[name] = found_s, n["right"], n["wrong"], n["twice"], n["posed"]
    return outcomes


def likely(frame: RgbdFrame, model: ReferenceModel) -> bool:
    """Whether a first detection finds an object, whether it is there or not."""
    seen = Seen(frame, NOWHERE, 0.0)
    request = Request(1, None, 0, (RequestedObject(model.name, None),))
    return any(answer.found and answer.quality >= LEAST for answer in Sight(model).answer(request, seen))


def rows(scene: BopScene, models: Mapping[str, ReferenceModel], given: argparse.Namespace) -> Iterator[Row]:
    """The rows of at most `given.images` frames of a scene, spread evenly."""
    targets = Targets(models)
    for image in images_of(scene, given.images):
        frame, labels = scene.frame(image), [] if given.strangers else scene.truths(image)
        kinds = kinds_of(labels, targets)
        rng = np.random.default_rng([given.seed, image])
        count = HZ * given.seconds
        outcomes = watched(frame, models, kinds, 1, count, rng) if given.together else {}
        away = sorted(set(models) - set(kinds))
        if not given.together:
            away = [str(name) for name in rng.permutation(away)[: 0 if given.several else given.absent]]
        for name in [*kinds, *away]:
            own = kinds.get(name, [])
            there = sum(visible for _, visible in own)
            if own and (there < 2 if given.several else (len(own), there) != (1, 1)):
                continue
            if not given.together and (own or likely(frame, models[name])):
                wanted = there + given.more if given.several else 1
                outcomes = watched(frame, {name: models[name]}, kinds, wanted, count, rng)
            yield Row(scene.name, image, name, there, count, *outcomes.get(name, ((), 0, 0, 0, 0)))


def heaps(folder: Path, models: Mapping[str, ReferenceModel], rng: Rng, frames: int) -> None:
    """Render `frames` frames with EACH instances of KINDS objects, chosen at random."""
    ids = {name: m.object_id for name, m in sorted(models.items()) if m.object_id is not None}
    kinds = [str(name) for name in rng.choice(list(ids), KINDS, replace=False)]
    meshes = {f"{name}_{k}": models[name].mesh for name in kinds for k in range(EACH)}
    numbers = {f"{name}_{k}": ids[name] for name in kinds for k in range(EACH)}
    write_rendered_set(folder, meshes, numbers, frames, int(rng.integers(2**31)))


def report(done: Sequence[Row]) -> str:
    """The results of the objects that are there, and of the absent ones, as text."""
    there, away = [r for r in done if r.there], [r for r in done if not r.there]
    right, wrong, twice = (sum(getattr(r, name) for r in there) for name in ("right", "wrong", "twice"))
    times = [s for r in there for s in r.found_s]
    found = "{:.1f} s, {:.1f} s".format(*np.percentile(times, (50, 90))) if times else "-"
    false, gone = sum(r.wrong for r in away), sum(r.frames for r in away)
    return (
        f"there: {len(times)} of {sum(r.there for r in there)} instances TRACKING and right, "
        f"{sum(s <= SOON_S for s in times)} within {SOON_S:g} s, (median, 90 %) {found}; "
        f"right in {right} of {sum(r.frames * r.there for r in there)} frames, "
        f"wrong in {wrong}, {twice} on an instance with another pose\n"
        f"absent: false TRACKING in {false} of {gone} frames, "
        f"of {sum(r.wrong > 0 for r in away)} of {len(away)} objects; a pose of any state in "
        f"{sum(r.posed for r in away)} frames, of {sum(r.posed > 0 for r in away)} objects"
    )


def main() -> None:
    """Play the films of all scenes, one by one, and print the results."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=int, default=6, help="length of each film (6)")
    parser.add_argument("--strangers", action="store_true", help="none of the objects is in the scenes")
    parser.add_argument("--absent", type=int, default=3, help="absent objects searched for in a frame (3)")
    parser.add_argument("--several", action="store_true", help="objects with two or more instances")
    parser.add_argument("--more", type=int, default=0, help="instances searched for beyond those there (0)")
    parser.add_argument("--together", action="store_true", help="all objects are known at once")
    parser.add_argument("--draw", action="store_true", help="render missing scenes")
    given = parser.parse_args()
    models = load_models(given.bundles)
    for number, folder in enumerate(given.bop):
        if given.draw and not folder.exists():
            heaps(folder, models, np.random.default_rng([given.seed, number]), given.images)
    done = filmed(given, lambda scene: rows(scene, models, given))
    for row in done:
        if row.wrong or row.twice or (row.posed and not row.there):
            counts = f"{row.wrong} wrong, {row.twice} twice, {row.posed} posed of {row.frames}"
            print(f"{row.scene} {row.image} {row.object}: {counts}")
    print(report(done))


if __name__ == "__main__":
    main()
