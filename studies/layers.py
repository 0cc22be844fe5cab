"""Draws layers of one product, side by side as in a shop or a carton: are all of them found?

    .venv/bin/python -m studies.layers --bundles DIR --place table --out OUT
    .venv/bin/python -m studies.still --several --seconds 3 --images 99 --bop OUT --bundles DIR --json J.json

Each frame shows up to 12 of one object, in rows, on its flat sides, 0 to 3 mm apart, every second one turned
by half where the rows are mixed. They lie on a table, in a carton whose rim is higher, or close to a camera
that sees little else. Light, camera and noise are those of `huepose.scenes.rendered`. Nothing is fitted on
it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from huepose.datasets.bop_writer import BopWriter
from huepose.geometry import Mesh, se3
from huepose.geometry.arrays import Float64, Rng, UInt8
from huepose.model import load_models
from huepose.scenes import textures
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.charts import OPEN_TOP, blocks
from huepose.scenes.frame import Stage, shoot
from huepose.scenes.heap import resting_turns
from huepose.scenes.rendered import T_ROOM_TABLE, SceneRanges, heaped_stage, labelled
from huepose.scenes.shapes import printed
from huepose.support.progress import progress

RANGES = SceneRanges(
    objects=(1, 1), others=(0, 0), distance_m=(0.6, 1.0), elevation_deg=(40.0, 85.0), exposure=(-0.7, 0.5)
)
CLOSE_M = (0.4, 0.55)
CLOSE_SIDE_M = 0.55
"""What a camera that is so near sees of a layer."""

GAP_M, RIM_M, WALL_M = 0.003, (0.01, 0.06), 0.006
"""Widest gap between neighbours; by how much the carton stands above them; and how thick its walls are."""


def row_of(mesh: Mesh, place: str, rng: Rng) -> tuple[Float64, Float64]:
    """Poses T_table_mesh (N, 4, 4) of a layer, its middle over the origin, its sides along x and y; and its
    size (3,)."""
    turns, areas = resting_turns(mesh)
    R = turns[int(rng.choice(len(turns), p=areas / areas.sum()))]
    _, _, angle_deg = cv2.minAreaRect(cv2.convexHull((mesh.vertices @ R.T)[:, :2].astype(np.float32)))
    R = se3.rotation_exp(np.array([0.0, 0.0, -np.radians(angle_deg)])) @ R
    points = mesh.vertices @ R.T
    low, high = points.min(0), points.max(0)
    step, middle = high - low + rng.uniform(0.0, GAP_M), (low + high) / 2.0
    across, along = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    if place == "close":
        across, along = (max(2, min(8, round(CLOSE_SIDE_M / side))) for side in step[:2])
    mixed, poses = rng.random() < 0.5, []
    for i in range(across):
        for j in range(along):
            half = se3.rotation_exp(np.array([0.0, 0.0, np.pi * (mixed and (i + j) % 2)]))
            at = step * [i - (across - 1) / 2.0, j - (along - 1) / 2.0, 0.0]
            at[2] = (high - low)[2] / 2.0 + 0.0005
            poses.append(se3.make(half @ R, at - half @ middle))
    return np.array(poses), np.array([across * step[0], along * step[1], (high - low)[2]])


def carton(size: Float64, rng: Rng) -> Mesh:
    """An open carton about a layer of that size (3,), on the table under the origin."""
    x, y = size[:2] / 2.0 + WALL_M
    lattice = [-x - WALL_M, -x, x, x + WALL_M], [-y - WALL_M, -y, y, y + WALL_M]
    charts = blocks(*lattice, [-WALL_M, 0.0, size[2] + rng.uniform(*RIM_M)], OPEN_TOP, 0.05)
    return printed(charts, [_plain] * len(charts), textures.palette(rng.uniform(), rng), rng, 256)


def _plain(rng: Rng, height: int, width: int, colors: textures.Palette) -> UInt8:
    return textures.plain(height, width, colors.base)


def layer(mesh: Mesh, place: str, seed: int, number: int) -> tuple[Stage, int]:
    """The stage of frame `number`, and how many instances come first in it."""
    ranges = replace(RANGES, distance_m=CLOSE_M) if place == "close" else RANGES
    around, _, _, _ = heaped_stage({"it": mesh}, seed, number, ranges)
    rng = np.random.default_rng([seed, number, 64])
    poses, size = row_of(mesh, place, rng)
    T = T_ROOM_TABLE @ se3.make(
        se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)])), np.zeros(3)
    )
    meshes, T_room = [mesh] * len(poses), list(T @ poses)
    if place == "carton":
        meshes.append(carton(size, rng))
        T_room.append(T)
    still = np.repeat(np.array(T_room)[:, None], 3, axis=1)
    stage = replace(
        around,
        meshes=(*meshes, *around.meshes[1:]),
        labelled=len(poses),
        T_room_mesh=np.concatenate([still, around.T_room_mesh[1:]]),
    )
    return stage, len(poses)


def main() -> None:
    """Draw a scene of one place."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundles", type=Path, required=True, metavar="DIR", help="reference models")
    parser.add_argument("--object", nargs="+", metavar="NAME", help="which of the objects (all)")
    parser.add_argument("--place", choices=("table", "carton", "close"), default="table")
    parser.add_argument("--frames", type=int, default=1, help="of each object (1)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    models = load_models(given.bundles, given.object)
    names = sorted(name for name, model in models.items() if model.object_id is not None)
    facts = {"seed": given.seed, "place": given.place, "objects": names, "frames": given.frames}
    writer = BopWriter(given.out, facts, ".png")
    for number in progress(range(len(names) * given.frames), f"drawing {given.out.name}"):
        if number in writer.done:
            continue
        model = models[names[number % len(names)]]
        stage, count = layer(model.mesh, given.place, given.seed, number)
        shot = shoot(stage, 1, number, COLOR, STEREO)
        labels = labelled(shot, stage.camera, [(model.object_id or 0, model.mesh)] * count)
        writer.add(number, shot.color, shot.depth, stage.camera, labels)


if __name__ == "__main__":
    main()
