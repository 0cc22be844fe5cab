"""Objects that the edge of the picture cuts, leave and come back: is a pose TRACKING where it is not right?

    .venv/bin/python -m studies.edge --bundles DIR --json OUT.json --seed 11 12

The drawn scene of five of the objects, chosen by the seed, is seen through a window of half its width and
height. Perception is that of a live pipeline, and knows one object.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from huepose.evaluation import metrics
from huepose.evaluation.result_files import write_json
from huepose.geometry import RgbdFrame
from huepose.model import ReferenceModel, load_models
from huepose.profiles import profile
from huepose.reinit.loop import ReinitLoop
from huepose.scenes.builtin import SyntheticScene
from huepose.support.progress import progress
from huepose.tracking import State, Tracker
from studies.gone import Sight
from studies.stress.films import Seen
from studies.stress.oracle import slot_of
from studies.stress.play import error_of, followed

OBJECTS = 5
ROWS, COLUMNS = slice(110, 370), slice(150, 490)
"""The window."""


@dataclass(frozen=True)
class Row:
    """Of one object of one scene: frames in which it is TRACKING and right; TRACKING and not right; the same
    of frames in which more than half of it is outside of the window."""

    seed: int
    object: str
    right: int
    wrong: int
    cut_right: int
    cut_wrong: int


def film(scene: SyntheticScene, name: str) -> Iterator[Seen]:
    """Once round the loop of a scene, through the window."""
    for sample in scene:
        truth = next(t for t in sample.truths if t.object == name)
        frame = sample.frame
        camera = frame.camera.cropped(
            COLUMNS.start, ROWS.start, COLUMNS.stop - COLUMNS.start, ROWS.stop - ROWS.start
        )
        color = np.ascontiguousarray(frame.color[ROWS, COLUMNS])
        depth = np.ascontiguousarray(frame.depth[ROWS, COLUMNS])
        stamp_ns = scene.stamp_ns(sample.image)
        assert truth.T_cam_obj is not None
        yield Seen(RgbdFrame(color, depth, camera, sample.image, stamp_ns), truth.T_cam_obj, 1.0)


def outside(model: ReferenceModel, seen: Seen) -> float:
    """Share of an object's surface points that lie beyond the picture."""
    camera = seen.frame.camera
    points = model.eval_points @ seen.T_cam_obj[:3, :3].T + seen.T_cam_obj[:3, 3]
    pixels = camera.project(points)
    size = np.array([camera.width, camera.height])
    return float(1.0 - ((pixels > -0.5) & (pixels < size - 0.5)).all(1).mean())


def watched(scene: SyntheticScene, seed: int, model: ReferenceModel) -> Row:
    """What becomes of one object."""
    tracker = Tracker({model.name: model}, profile("live").tracker)
    loop, counts = ReinitLoop(objects=[slot_of(model)]), [0, 0, 0, 0]
    for seen, poses in followed(film(scene, model.name), tracker, loop, Sight(model)):
        for pose in poses:
            if pose.state is State.TRACKING:
                wrong = error_of(model, pose.T_cam_obj, seen.T_cam_obj) >= metrics.RECALL_FRACTION
                counts[wrong] += 1
                counts[2 + wrong] += outside(model, seen) > 0.5
    return Row(seed, model.name, *counts)


def report(done: Sequence[Row]) -> str:
    """What is right and wrong, and of that what is cut."""
    right, wrong, cut_right, cut_wrong = (
        sum(getattr(row, name) for row in done) for name in ("right", "wrong", "cut_right", "cut_wrong")
    )
    return (
        f"TRACKING: {right} right, {wrong} wrong; "
        f"of these {cut_right} right, {cut_wrong} wrong with more than half outside of the picture"
    )


def main() -> None:
    """Watch the objects of all scenes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--seed", type=int, nargs="+", default=[11, 12, 13, 14])
    given = parser.parse_args()
    models = load_models(given.bundles)
    done: list[Row] = []
    for seed in progress(given.seed, "scenes"):
        some = np.random.default_rng(seed).choice(len(models), min(OBJECTS, len(models)), replace=False)
        names = [list(models)[k] for k in sorted(some)]
        scene = SyntheticScene(seed, objects={name: models[name].mesh for name in names})
        done += [watched(scene, seed, models[name]) for name in names]
        write_json(given.json, {"rows": [asdict(row) for row in done]})
    for row in done:
        if row.wrong:
            print(f"{row.seed} {row.object}: {row.wrong} wrong, {row.right} right")
    print(report(done))


if __name__ == "__main__":
    main()
