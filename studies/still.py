"""A camera that stands still, and one kind of object that is known: is it found, and is anything else taken
for it?

    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json [--strangers]
    .venv/bin/python -m studies.still --bop SCENE... --bundles DIR --json OUT.json --several [--more 2]

Each object that stands alone of its kind in a frame is looked for, and some that are not there. With
`--several` instead each kind of which a frame shows two or more, as many as it shows and `--more`; with
`--draw` scenes that are not there are drawn first: heaps of two kinds of the bundles, four of each.
Perception is that of a live pipeline, and knows this one kind. What is not there and not found by a first
look, with a quality of 0.1, is watched no further.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

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
from huepose.reinit.types import ObjectSlot, Request, RequestedObject
from huepose.scenes.rendered import write_rendered_set
from huepose.tracking import Tracker
from studies.gone import HZ, Sight, filmed, images_of, parser_of, shown
from studies.stress.films import Seen
from studies.stress.play import error_of, followed

LEAST, SOON_S = 0.1, 2.0
"""Quality from which on a first look finds an object; what counts as found soon."""

KINDS, EACH = 2, 4
"""What is drawn: kinds in a scene, and instances of each."""

NOWHERE = np.full((4, 4), np.inf)
"""The true pose in a film, which only an oracle reads."""

Instance = tuple[Float64, bool]
"""Its pose T_cam_obj (4, 4), and whether it is visible."""


@dataclass(frozen=True)
class Row:
    """Of one kind of one frame. there: instances that are visible; frames: of the film; found_s: when each of
    those that were TRACKING and right was so first; right, wrong: poses that are TRACKING and right, or not,
    in all frames; twice: right ones on an instance that another one is on."""

    scene: str
    image: int
    object: str
    there: int
    frames: int
    found_s: tuple[float, ...]
    right: int
    wrong: int
    twice: int


def watched(
    frame: RgbdFrame, model: ReferenceModel, instances: Sequence[Instance], wanted: int, count: int, rng: Rng
) -> tuple[tuple[float, ...], int, int, int]:
    """What is seen of the instances of a kind in a film of so many frames of this one, as `found_s` and what
    follows it in a row. wanted: so many are looked for."""
    frames = [Seen(shown(frame, n, rng), NOWHERE, 1.0) for n in range(count)]
    tracker = Tracker({model.name: model}, profile("live").tracker)
    loop = ReinitLoop(objects=[ObjectSlot.of(model, wanted)])
    first: dict[int, float] = {}
    right = wrong = twice = 0
    for number, (_, poses) in enumerate(followed(frames, tracker, loop, Sight(model))):
        taken: set[int] = set()
        for pose in poses:
            if pose.state is not State.TRACKING:
                continue
            errors = {k: error_of(model, pose.T_cam_obj, truth) for k, (truth, _) in enumerate(instances)}
            k = min(errors, key=errors.__getitem__, default=-1)
            if k < 0 or errors[k] >= metrics.RECALL_FRACTION:
                wrong += 1
                continue
            right, twice = right + 1, twice + (k in taken)
            taken.add(k)
            first.setdefault(k, number / HZ)
    return tuple(sorted(s for k, s in first.items() if instances[k][1])), right, wrong, twice


def likely(frame: RgbdFrame, model: ReferenceModel) -> bool:
    """Whether a first look finds an object, be it there or not."""
    seen = Seen(frame, NOWHERE, 0.0)
    request = Request(1, None, 0, (RequestedObject(model.name, None),))
    return any(answer.found and answer.quality >= LEAST for answer in Sight(model).answer(request, seen))


def kinds_of(labels: Sequence[GroundTruth], targets: Targets) -> dict[str, list[Instance]]:
    """The instances of the kinds that are known, by name."""
    kinds: dict[str, list[Instance]] = {}
    for label in labels:
        model = targets.model_of(label)
        if model is not None and label.T_cam_obj is not None:
            kinds.setdefault(model.name, []).append((label.T_cam_obj, label.visible))
    return kinds


def rows(scene: BopScene, models: Mapping[str, ReferenceModel], given: argparse.Namespace) -> Iterator[Row]:
    """Of at most so many frames of a scene as are `given`, spread evenly."""
    targets = Targets(models)
    for image in images_of(scene, given.images):
        frame, labels = scene.frame(image), [] if given.strangers else scene.truths(image)
        kinds = kinds_of(labels, targets)
        rng = np.random.default_rng([given.seed, image])
        absent = 0 if given.several else given.absent
        away = rng.permutation(sorted(set(models) - set(kinds)))[:absent]
        count = HZ * given.seconds
        for name, own in [*kinds.items(), *((str(n), list[Instance]()) for n in away)]:
            there = sum(visible for _, visible in own)
            if own and (there < 2 if given.several else (len(own), there) != (1, 1)):
                continue
            seen: tuple[tuple[float, ...], int, int, int] = (), 0, 0, 0
            if own or likely(frame, models[name]):
                wanted = there + given.more if given.several else 1
                seen = watched(frame, models[name], own, wanted, count, rng)
            yield Row(scene.name, image, name, there, count, *seen)


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
        f"in {sum(r.wrong > 0 for r in away)} of {len(away)} films"
    )


def main() -> None:
    """Watch all kinds of the scenes, one by one."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=int, default=6, help="of each film (6)")
    parser.add_argument("--strangers", action="store_true", help="none of the objects is in the scenes")
    parser.add_argument("--absent", type=int, default=3, help="objects that are not there, of each frame (3)")
    parser.add_argument("--several", action="store_true", help="kinds of which there are two or more")
    parser.add_argument("--more", type=int, default=0, help="so many more of these than there are (0)")
    parser.add_argument("--draw", action="store_true", help="scenes that are not there")
    given = parser.parse_args()
    models = load_models(given.bundles)
    for number, folder in enumerate(given.bop):
        if given.draw and not folder.exists():
            heaps(folder, models, np.random.default_rng([given.seed, number]), given.images)
    done = filmed(given, lambda scene: rows(scene, models, given))
    for row in done:
        if row.wrong or row.twice:
            print(f"{row.scene} {row.image} {row.object}: {row.wrong} wrong, {row.twice} twice")
    print(report(done))


if __name__ == "__main__":
    main()
