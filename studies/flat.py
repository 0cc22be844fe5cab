"""Draws flat printed things that lie on a table, such as cards, phones, bars and books: are they found?

    .venv/bin/python -m studies.flat --out OUT
    huepose eval perception --bop OUT/scene --bundles OUT/bundles --json perception.json
    .venv/bin/python -m studies.still --bop OUT/scene --bundles OUT/bundles --images 99 --json still.json

Twelve things of 3 to 18 mm, and frames with three of them, apart, among other things. Light, camera and noise
are those of `huepose.scenes.rendered`. Nothing is fitted on it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from huepose.datasets.bop_writer import BopWriter
from huepose.geometry import Mesh, se3
from huepose.geometry.arrays import Float64, Rng
from huepose.model.io import model_path, save_model
from huepose.onboarding.onboard import onboard_mesh
from huepose.scenes import textures
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.charts import blocks, revolved
from huepose.scenes.frame import shoot
from huepose.scenes.heap import resting_turns
from huepose.scenes.rendered import T_ROOM_TABLE, SceneRanges, heaped_stage, labelled
from huepose.scenes.shapes import printed
from huepose.support.progress import progress

THINGS, EACH = 12, 3
"""How many there are, and how many are in a frame."""

THICK_M, WIDE_M, LONG_M = (0.003, 0.018), (0.06, 0.13), (0.07, 0.2)
"""Of the things: from that of a card to that of a book."""

APART_M = 0.24
"""Diameter of the circle on which the middles of a frame's things lie."""

RANGES = SceneRanges(objects=(EACH, EACH), distance_m=(0.45, 1.1), elevation_deg=(35.0, 85.0))
WORDS = ("ATLAS", "MENU", "COCOA", "TRAVEL", "NOTES", "RADIO",
         "LEMON", "PUZZLE", "CARDS", "GARDEN", "PILOT", "SNACK")  # fmt: skip


def thing(number: int, seed: int) -> Mesh:
    """A box, or every fourth a disc, printed on both sides."""
    rng = np.random.default_rng([seed, number, 71])
    colors = textures.palette(rng.uniform(), rng)
    z, x, y = (rng.uniform(*span) / 2.0 for span in (THICK_M, WIDE_M, LONG_M))
    word = WORDS[number % len(WORDS)]
    if number % 4 == 3:
        lower, edge, upper = (
            [(0.0, -z), (0.5 * x, -z), (x, -z)],
            [(x, -z), (x, z)],
            [(x, z), (0.5 * x, z), (0.0, z)],
        )
        arts = [textures.lid("BASE"), textures.wrapper("RIM", "round", "1"), textures.lid(word)]
        return printed(revolved([lower, edge, upper]), arts, colors, rng)
    charts = blocks([-x, x], [-y, y], [-z, z], np.ones((1, 1, 1), bool))
    sides = [textures.blocks(f"SIDE {k}") for k in range(4)]
    front = textures.front(word, "of the day", str(number))
    return printed(
        charts,
        [*sides, textures.facts if number % 3 else textures.front("BACK", word, "0"), front],
        colors,
        rng,
    )


def lying(meshes: list[Mesh], rng: Rng) -> Float64:
    """Poses T_room_mesh (N, 4, 4) of things on their largest sides, around the middle of the table."""
    start, poses = rng.uniform(0.0, 2.0 * np.pi), []
    for k, mesh in enumerate(meshes):
        turns, areas = resting_turns(mesh)
        R = turns[int(np.argmax(areas))]
        R = np.diag([1.0, -1.0, -1.0]) @ R if rng.random() < 0.5 else R
        R = se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)])) @ R
        angle = start + 2.0 * np.pi * k / len(meshes)
        low = float((mesh.vertices @ R.T)[:, 2].min())
        at = np.array([APART_M / 2.0 * np.cos(angle), APART_M / 2.0 * np.sin(angle), 0.0005 - low])
        poses.append(T_ROOM_TABLE @ se3.make(R, at))
    return np.array(poses)


def main() -> None:
    """Draw the things, learn them, and draw the frames."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    names = {f"flat_{k:02d}": k + 1 for k in range(THINGS)}
    meshes = {name: thing(k - 1, given.seed) for name, k in names.items()}
    for name, k in progress(list(names.items()), "learning the things"):
        path = model_path(given.out / "bundles", name)
        if not path.exists():
            save_model(onboard_mesh(meshes[name], name, object_id=k), path)
    writer = BopWriter(given.out / "scene", {"seed": given.seed, "objects": names}, ".png")
    for number in progress(range(given.frames), "drawing"):
        if number in writer.done:
            continue
        stage, shown, _, _ = heaped_stage(meshes, given.seed, number, RANGES)
        rng = np.random.default_rng([given.seed, number, 72])
        T_room = stage.T_room_mesh.copy()
        T_room[:EACH] = lying([meshes[name] for name in shown], rng)[:, None]
        shot = shoot(replace(stage, T_room_mesh=T_room), 1, number, COLOR, STEREO)
        labels = labelled(shot, stage.camera, [(names[name], meshes[name]) for name in shown])
        writer.add(number, shot.color, shot.depth, stage.camera, labels)


if __name__ == "__main__":
    main()
