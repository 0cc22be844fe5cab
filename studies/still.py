"""A camera that stands still, and one kind of object that is known, or many at once: is it found, and is
anything else taken for it?

    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json [--strangers]
    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json --several [--more 2]
    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json --together --seconds 8

Each object that stands alone of its kind in a frame is looked for, and some that are not there. With
`--several` instead each kind of which a frame shows two or more, as many as it shows and `--more`; with
`--draw` scenes that are not there are drawn first: heaps of two kinds of the bundles, four of each.
Perception is that of a live pipeline, and knows this one kind. What is not there and not found by a first
look, with a quality of 0.1, is watched no further. With `--together` one film shows all: every kind of the
bundles is known and looked for at once.
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
"""Quality from which on a first look finds an object; what counts as found soon."""

KINDS, EACH = 2, 4
"""What is drawn: kinds in a scene, and instances of each."""


@dataclass(frozen=True)
class Row:
    """Of one kind of one frame. there: instances that are visible; frames: of the film; found_s: when each of
    those that were TRACKING and right was so first; right, wrong: poses that are TRACKING and right, or not,
    in all frames; twice: right ones on an instance that another one is on; posed: poses of any state."""

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


Told = tuple[tuple[float, ...], int, int, int, int]
"""Of a kind: `found_s` and what follows it in a row."""


def watched(
    frame: RgbdFrame,
    models: Mapping[str, ReferenceModel],
    kinds: Mapping[str, Sequence[Instance]],
    wanted: int,
    count: int,
    rng: Rng,
) -> dict[str, Told]:
    """What is seen of the instances of each known kind in a film of so many frames of this one. wanted: so
    many of each are looked for."""
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
    told: dict[str, Told] = {}
    for name, n in counts.items():
        found_s = tuple(sorted(s for k, s in first[name].items() if kinds[name][k][1]))
        told[name] = found_s, n["right"], n["wrong"], n["twice"], n["posed"]
    return told


def likely(frame: RgbdFrame, model: ReferenceModel) -> bool:
    """Whether a first look finds an object, be it there or not."""
    seen = Seen(frame, NOWHERE, 0.0)
    request = Request(1, None, 0, (RequestedObject(model.name, None),))
    return any(answer.found and answer.quality >= LEAST for answer in Sight(model).answer(request, seen))


def rows(scene: BopScene, models: Mapping[str, ReferenceModel], given: argparse.Namespace) -> Iterator[Row]:
    """Of at most so many frames of a scene as are `given`, spread evenly."""
    targets = Targets(models)
    for image in images_of(scene, given.images):
        frame, labels = scene.frame(image), [] if given.strangers else scene.truths(image)
        kinds = kinds_of(labels, targets)
        rng = np.random.default_rng([given.seed, image])
        count = HZ * given.seconds
        told = watched(frame, models, kinds, 1, count, rng) if given.together else {}
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
                told = watched(frame, {name: models[name]}, kinds, wanted, count, rng)
            yield Row(scene.name, image, name, there, count, *told.get(name, ((), 0, 0, 0, 0)))


def heaps(folder: Path, models: Mapping[str, ReferenceModel], rng: Rng, frames: int) -> None:
    """Draw so many frames with EACH of KINDS kinds, chosen at random."""
    ids = {name: m.object_id for name, m in sorted(models.items()) if m.object_id is not None}
    kinds = [str(name) for name in rng.choice(list(ids), KINDS, replace=False)]
    meshes = {f"{name}_{k}": models[name].mesh for name in kinds for k in range(EACH)}
    numbers = {f"{name}_{k}": ids[name] for name in kinds for k in range(EACH)}
    write_rendered_set(folder, meshes, numbers, frames, int(rng.integers(2**31)))


def report(done: Sequence[Row]) -> str:
    """What became of those that are there, and of those that are not."""
    there, away = [r for r in done if r.there], [r for r in done if not r.there]
    right, wrong, twice = (sum(getattr(r, name) for r in there) for name in ("right", "wrong", "twice"))
    times = [s for r in there for s in r.found_s]
    found = "{:.1f} s, {:.1f} s".format(*np.percentile(times, (50, 90))) if times else "-"
    false, gone = sum(r.wrong for r in away), sum(r.frames for r in away)
    return (
        f"there: {len(times)} of {sum(r.there for r in there)} instances TRACKING and right, "
        f"{sum(s <= SOON_S for s in times)} within {SOON_S:g} s, (median, 90 %) {found}; "
        f"right in {right} of {sum(r.frames * r.there for r in there)} frames, "
        f"wrong in {wrong}, {twice} on one that has a pose\n"
        f"not there: false TRACKING in {false} of {gone} frames, "
        f"of {sum(r.wrong > 0 for r in away)} of {len(away)} kinds; a pose of any state in "
        f"{sum(r.posed for r in away)} frames, of {sum(r.posed > 0 for r in away)} kinds"
    )


def main() -> None:
    """Watch all kinds of the scenes, one by one."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=int, default=6, help="of each film (6)")
    parser.add_argument("--strangers", action="store_true", help="none of the objects is in the scenes")
    parser.add_argument("--absent", type=int, default=3, help="objects that are not there, of each frame (3)")
    parser.add_argument("--several", action="store_true", help="kinds of which there are two or more")
    parser.add_argument("--more", type=int, default=0, help="so many more of these than there are (0)")
    parser.add_argument("--together", action="store_true", help="all kinds are known at once")
    parser.add_argument("--draw", action="store_true", help="scenes that are not there")
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
