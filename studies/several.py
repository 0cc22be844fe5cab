"""Several of a kind before a camera that stands still: are all found, and is nothing taken for one more?

    .venv/bin/python -m studies.several --bop SCENE... --bundles DIR --json OUT.json [--more 2] [--draw]

Each kind of which a frame shows two or more is looked for, as many as it shows and `--more`. Perception is
that of a live pipeline, and knows this one kind, for four seconds. With `--draw` scenes that are not there
are drawn first: heaps of two kinds of the bundles, four of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets
from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64, Rng
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.loop import ReinitLoop
from huepose.scenes.rendered import write_rendered_set
from huepose.tracking import Tracker
from studies.gone import HZ, Sight, filmed, parser_of, shown
from studies.stress.films import Seen
from studies.stress.oracle import slot_of
from studies.stress.play import error_of, followed

SECONDS = 4
KINDS, EACH = 2, 4
"""What is drawn: kinds in a scene, and instances of each."""


@dataclass(frozen=True)
class Row:
    """Of one kind of one frame. there, found: instances that are visible, and those of them that were
    TRACKING and right; found_s: when each was first; frames: of the film; right, wrong: poses that are
    TRACKING and right, or not, in all frames; twice: poses on an instance that another one is on."""

    scene: str
    image: int
    object: str
    there: int
    found: int
    found_s: tuple[float, ...]
    frames: int
    right: int
    wrong: int
    twice: int


def watched(
    frame: RgbdFrame, model: ReferenceModel, truths: Sequence[Float64], visible: set[int], more: int, rng: Rng
) -> tuple[dict[int, float], int, int, int]:
    """When each of the instances with these poses (4, 4) was first TRACKING and right, seconds; and how many
    poses were right, wrong, and on an instance that had one. visible: which of the instances are; more:
    so many are looked for that are not there."""
    frames = [Seen(shown(frame, n, rng), truths[0], 1.0) for n in range(HZ * SECONDS)]
    tracker = Tracker({model.name: model}, profile("live").tracker)
    loop = ReinitLoop(objects=[replace(slot_of(model), max_instances=len(visible) + more)])
    first: dict[int, float] = {}
    right = wrong = twice = 0
    for number, (_, poses) in enumerate(followed(frames, tracker, loop, Sight(model))):
        taken: set[int] = set()
        for pose in poses:
            if pose.state is not State.TRACKING:
                continue
            errors = [error_of(model, pose.T_cam_obj, truth) for truth in truths]
            k = int(np.argmin(errors))
            if errors[k] >= metrics.RECALL_FRACTION:
                wrong += 1
                continue
            right, twice = right + 1, twice + (k in taken)
            taken.add(k)
            first.setdefault(k, number / HZ)
    return {k: s for k, s in first.items() if k in visible}, right, wrong, twice


def rows(scene: BopScene, targets: Targets, most: int, more: int, seed: int) -> Iterator[Row]:
    """All kinds of at most so many frames of a scene, spread evenly."""
    for image in scene.image_ids[:: -(-len(scene.image_ids) // most)]:
        frame = scene.frame(image)
        by_name: dict[str, list[tuple[Float64, bool]]] = {}
        for label in scene.truths(image):
            model = targets.model_of(label)
            if model is not None and label.T_cam_obj is not None:
                by_name.setdefault(model.name, []).append((label.T_cam_obj, label.visible))
        for name, labels in sorted(by_name.items()):
            visible = {k for k, (_, seen) in enumerate(labels) if seen}
            if len(visible) < 2:
                continue
            rng = np.random.default_rng([seed, image])
            model = next(m for m in targets.models if m.name == name)
            first, *counts = watched(frame, model, [T for T, _ in labels], visible, more, rng)
            times = tuple(sorted(first.values()))
            yield Row(scene.name, image, name, len(visible), len(first), times, HZ * SECONDS, *counts)


def heaps(folder: Path, models: Mapping[str, ReferenceModel], rng: Rng, frames: int) -> None:
    """Draw so many frames with EACH of KINDS kinds, chosen at random."""
    ids = {name: m.object_id for name, m in sorted(models.items()) if m.object_id is not None}
    kinds = [str(name) for name in rng.choice(list(ids), KINDS, replace=False)]
    meshes = {f"{name}_{k}": models[name].mesh for name in kinds for k in range(EACH)}
    numbers = {f"{name}_{k}": ids[name] for name in kinds for k in range(EACH)}
    write_rendered_set(folder, meshes, numbers, frames, int(rng.integers(2**31)))


def report(done: Sequence[Row]) -> str:
    """How many were found, when, and what was taken for one."""
    there, found, right, wrong, twice = (
        sum(getattr(row, name) for row in done) for name in ("there", "found", "right", "wrong", "twice")
    )
    times = [s for row in done for s in row.found_s]
    soon = f"{np.median(times):.1f} s, {np.percentile(times, 90):.1f} s" if times else "-"
    return (
        f"found {found} of {there} instances, after (median, 90 %) {soon}; "
        f"TRACKING: {right} right, {wrong} wrong, {twice} on one that has a pose"
    )


def main() -> None:
    """Look for all kinds of the scenes, one by one."""
    parser = parser_of(__doc__)
    parser.add_argument("--more", type=int, default=0, help="so many more than there are (0)")
    parser.add_argument("--draw", action="store_true", help="scenes that are not there")
    given = parser.parse_args()
    models = load_models(given.bundles)
    for number, folder in enumerate(given.bop):
        if given.draw and not folder.exists():
            heaps(folder, models, np.random.default_rng([given.seed, number]), given.images)
    targets = Targets(models)
    done = filmed(given, lambda scene: rows(scene, targets, given.images, given.more, given.seed))
    for row in done:
        if row.found < row.there or row.wrong or row.twice:
            print(f"{row.scene} {row.image} {row.object}: {row.found} of {row.there}, {row.wrong} wrong")
    print(report(done))


if __name__ == "__main__":
    main()
