"""Draw sequences of objects that are carried and turned fast, in Fast-YCB's layout, with exact truth.

    python -m studies.drawn_sequences --bundles BUNDLES --out OUT --seed 21 --count 16 --objects 1 3 5 8

Each sequence shows one object for two seconds at 30 Hz: up to 0.45 to 0.75 m/s and 260 to 380 degrees a
second, over a table or a plain ground with other objects on it, sometimes behind one; the light has any
strength, so that whites may be overexposed. Every second sequence has depth as an active stereo camera gives
it."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from huepose.datasets.fast_ycb import FastYcbFrame, write_fast_ycb
from huepose.model import ReferenceModel, load_models
from huepose.scenes import carried
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.frame import Stage, shoot
from huepose.scenes.official_sets import fast_ycb_frame
from huepose.support.progress import progress

FRAMES, RATE_HZ = carried.FRAMES, carried.RATE_HZ


def main() -> None:
    """Draw what is asked for; sequences that are there already are kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundles", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--objects", type=int, nargs="+", required=True, help="BOP ids, one after the other")
    arguments = parser.parse_args()
    models = {m.object_id: m for m in load_models(arguments.bundles).values() if m.object_id is not None}
    for number in progress(range(arguments.count), "drawing"):
        model = models[arguments.objects[number % len(arguments.objects)]]
        folder = arguments.out / f"{number:03d}" / model.name
        if not (folder / "gt" / "poses_ycb.txt").exists():
            rng = np.random.default_rng([arguments.seed, number])
            others = [m.mesh for m in models.values() if m is not model]
            stage = carried.staged(model.mesh, others, rng)
            write(folder, model, stage, arguments.seed * 1000 + number, stereo=number % 2 == 1)


def write(folder: Path, model: ReferenceModel, stage: Stage, seed: int, stereo: bool) -> None:
    """Shoot every frame of a stage into a folder; `visib_fract.json` has the visible share of each."""
    visible = []

    def frames() -> Iterator[FastYcbFrame]:
        for i in range(FRAMES):
            shot = shoot(stage, i, seed, COLOR, STEREO if stereo else None)
            visible.append(float(shot.labels.visib_fract[0]))
            yield fast_ycb_frame(shot)

    write_fast_ycb(folder, model.name, frames(), carried.CAMERA, RATE_HZ, model.frame_offset_m)
    (folder / "visib_fract.json").write_text(json.dumps(visible))


if __name__ == "__main__":
    main()
