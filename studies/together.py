"""A camera that stands still, and many objects that are known, most of them not there: what is TRACKING?

    .venv/bin/python -m studies.together --bop SCENE... --bundles DIR --json OUT.json [--seconds 8]

All kinds of the bundles are looked for at once, as in a live pipeline. Of each kind that a frame shows
once: when it is TRACKING and right, and in how many frames it is so or wrong. Of each kind that is not there:
in how many frames it has a pose, and in how many that is TRACKING.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.believe.state import State
from huepose.datasets.bop import BopScene
from huepose.evaluation import metrics
from huepose.evaluation.targets import Targets
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.loop import ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.tracking import TrackedPose, Tracker
from studies.gone import HZ, Sight, filmed, images_of, parser_of, shown
from studies.still import NOWHERE, SOON_S, kinds_of
from studies.stress.films import Seen
from studies.stress.play import error_of, followed


@dataclass(frozen=True)
class Row:
    """Of one kind of one frame. there: it is visible, once; found_s: when it was first TRACKING and right;
    right, wrong, posed: frames in which it is TRACKING and right, TRACKING and not right, has any pose;
    frames: of the film."""

    scene: str
    image: int
    object: str
    there: bool
    frames: int
    found_s: float | None
    right: int
    wrong: int
    posed: int


def rows(
    scene: BopScene, models: Mapping[str, ReferenceModel], images: int, seconds: int, seed: int
) -> Iterator[Row]:
    """Of at most so many frames of a scene, spread evenly."""
    targets = Targets(models)
    for image in images_of(scene, images):
        frame, kinds = scene.frame(image), kinds_of(scene.truths(image), targets)
        rng = np.random.default_rng([seed, image])
        films = [Seen(shown(frame, n, rng), NOWHERE, 1.0) for n in range(HZ * seconds)]
        tracker = Tracker(models, profile("live").tracker)
        loop = ReinitLoop(objects=[ObjectSlot.of(model) for model in models.values()])
        told: dict[str, list[TrackedPose | None]] = {name: [] for name in models}
        for _, poses in followed(films, tracker, loop, Sight(*models.values())):
            of = {pose.object: pose for pose in poses if pose.T_cam_obj is not None}
            for name, row in told.items():
                row.append(of.get(name))
        for name, row in told.items():
            instances = kinds.get(name, [])
            if len(instances) > 1 or (instances and not instances[0][1]):
                continue
            truths = [T for T, _ in instances]
            right = [_right(models[name], pose, truths) for pose in row]
            sure = [pose is not None and pose.state is State.TRACKING for pose in row]
            good = [a and b for a, b in zip(sure, right, strict=True)]
            yield Row(
                scene.name,
                image,
                name,
                bool(instances),
                len(row),
                good.index(True) / HZ if any(good) else None,
                sum(good),
                sum(sure) - sum(good),
                sum(pose is not None for pose in row),
            )


def _right(model: ReferenceModel, pose: TrackedPose | None, truths: Sequence[Float64]) -> bool:
    errors = (error_of(model, pose.T_cam_obj, truth) for truth in truths) if pose is not None else ()
    return min(errors, default=np.inf) < metrics.RECALL_FRACTION


def report(done: Sequence[Row]) -> str:
    """What became of those that are there, and of those that are not."""
    there, away = [r for r in done if r.there], [r for r in done if not r.there]
    times = [r.found_s for r in there if r.found_s is not None]
    return (
        f"there: {len(times)} of {len(there)} TRACKING and right, {sum(s <= SOON_S for s in times)} within "
        f"{SOON_S:g} s; right in {sum(r.right for r in there)} of {sum(r.frames for r in there)} frames, "
        f"wrong in {sum(r.wrong for r in there)}\n"
        f"not there: {len(away)} kinds; false TRACKING in {sum(r.wrong for r in away)} of "
        f"{sum(r.frames for r in away)} frames, {sum(r.wrong > 0 for r in away)} kinds; "
        f"a pose of any state in {sum(r.posed for r in away)} frames, {sum(r.posed > 0 for r in away)} kinds"
    )


def main() -> None:
    """Watch the frames of the scenes."""
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=int, default=8, help="of each film (8)")
    given = parser.parse_args()
    models = load_models(given.bundles)
    done = filmed(given, lambda scene: rows(scene, models, given.images, given.seconds, given.seed))
    for row in done:
        if row.wrong or (not row.there and row.posed):
            print(
                f"{row.scene} {row.image} {row.object}: {row.wrong} wrong, {row.posed} posed of {row.frames}"
            )
    print(report(done))


if __name__ == "__main__":
    main()
