"""Draw sequences of objects that are carried and turned fast, in Fast-YCB's layout, with exact truth.

    python -m studies.drawn_sequences --bundles BUNDLES --out OUT --seed 21 --count 16 --objects 1 3 5 8

Each sequence shows one object for two seconds at 30 Hz: up to 0.45 to 0.75 m/s and 260 to 380 degrees a
second, over a table or a plain ground with other objects on it, sometimes behind one; the light has any
strength, so that whites may be overexposed. Every second sequence has depth as an active stereo camera gives
it."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel, load_models
from huepose.scenes.frame import Stage, shoot
from huepose.scenes.light import random_light
from huepose.scenes.motion import positions, rotations
from huepose.scenes.room import sheet, table_top, wallpaper
from huepose.scenes.sensor import COLOR, STEREO
from huepose.support.progress import progress

CAMERA = Camera(614.0, 614.0, 319.5, 239.5, 640, 480)
FRAMES, RATE_HZ = 60, 30
OTHERS = 5
"""Objects that lie on the ground."""

BEHIND = 0.35
"""Share of the sequences in which something hangs between camera and object."""

Placed = tuple[Mesh, Float64]
Rng = np.random.Generator


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
            stage = staged(model, [m for m in models.values() if m is not model], rng)
            write(folder, model, stage, arguments.seed * 1000 + number, stereo=number % 2 == 1)


def staged(model: ReferenceModel, others: list[ReferenceModel], rng: Rng) -> Stage:
    """The object on its path, the ground, what lies on it, and a light."""
    pixel, middle_m = rng.uniform((230, 170), (410, 310)), rng.uniform(0.5, 0.8)
    path = carried(rng, CAMERA.backproject(pixel[None], np.array([middle_m]))[0], model.mesh.centre)
    ground_m = rng.uniform(0.95, 1.25)
    texture = (table_top if rng.random() < 0.5 else wallpaper)(rng)
    if rng.random() < 0.4:
        texture = np.full((64, 64, 3), rng.integers(120, 256, 3), np.uint8)
    tilt = np.array([np.pi + rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4), 0.0])
    standing: list[Placed] = [
        (
            sheet(2.6, 2.2, np.ascontiguousarray(texture)),
            se3.make(se3.rotation_exp(tilt), np.array([0, 0, ground_m])),
        )
    ]
    for k in rng.choice(len(others), min(OTHERS, len(others)), replace=False):
        place = rng.uniform((60, 60), (580, 430)), ground_m - rng.uniform(0.03, 0.12)
        standing.append(_somewhere(others[int(k)], *place, rng))
    if rng.random() < BEHIND:
        place = pixel + rng.uniform(-120, 120, 2), middle_m - rng.uniform(0.12, 0.2)
        standing.append(_somewhere(others[int(rng.integers(len(others)))], *place, rng))
    light = random_light(rng)
    light = replace(
        light,
        key=light.key * float(np.exp(rng.uniform(-0.9, 0.9))),
        sky=light.sky * float(np.exp(rng.uniform(-0.7, 0.7))),
    )
    n = len(path)
    paths = np.array([path, *(np.broadcast_to(T, (n, 4, 4)) for _, T in standing)])
    meshes = (model.mesh, *(mesh for mesh, _ in standing))
    return Stage(meshes, 1, paths, np.tile(np.eye(4), (n, 1, 1)), (light,) * n, CAMERA)


def carried(rng: Rng, middle_cam: Float64, centre_obj: Float64) -> Float64:
    """Poses (N, 4, 4) of an object that a fast hand carries and turns about a place (3,)."""
    k, phase = int(rng.integers(4, 6)), np.linspace(0.0, 0.999, FRAMES + 1)
    place = positions(rng.normal(0, 1, (k, 3)) * (1.0, 0.7, 0.6), phase)
    place -= place.mean(0)
    fastest = float(np.linalg.norm(np.diff(place, axis=0), axis=1).max()) * RATE_HZ
    place = middle_cam + place * (rng.uniform(0.45, 0.75) / fastest)
    turns, base = rng.normal(0, 1, (k, 3)), Rotation.random(random_state=int(rng.integers(1 << 30)))
    limit, low, high = np.radians(rng.uniform(260, 380)), 0.0, 4.0

    def turned(amplitude: float) -> Float64:
        return rotations((Rotation.from_rotvec(amplitude * turns) * base).as_matrix(), phase)

    for _ in range(12):
        half = (low + high) / 2.0
        R = turned(half)
        steps = [np.linalg.norm(Rotation.from_matrix(R[i + 1] @ R[i].T).as_rotvec()) for i in range(FRAMES)]
        low, high = (half, high) if max(steps) * RATE_HZ < limit else (low, half)
    R = turned(low)
    path = np.tile(np.eye(4), (FRAMES + 1, 1, 1))
    path[:, :3, :3], path[:, :3, 3] = R, place - R @ centre_obj
    return path


def _somewhere(model: ReferenceModel, pixel: Float64, depth_m: float, rng: Rng) -> Placed:
    R = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    centre = CAMERA.backproject(pixel[None], np.array([depth_m]))[0]
    return model.mesh, se3.make(R, centre - R @ model.mesh.centre)


def write(folder: Path, model: ReferenceModel, stage: Stage, seed: int, stereo: bool) -> None:
    """Shoot every frame of a stage into a folder; `visib_fract.json` has the visible share of each."""
    for part in ("rgb", "depth", "gt", "masks/gt"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    offset = np.zeros(3) if model.frame_offset_m is None else model.frame_offset_m
    rows, visible = [], []
    for i in range(FRAMES):
        shot = shoot(stage, i, seed, COLOR, STEREO if stereo else None)
        cv2.imwrite(str(folder / "rgb" / f"{i}.png"), shot.color[..., ::-1])
        size = np.array([CAMERA.width, CAMERA.height], "<u8")
        (folder / "depth" / f"{i}.float").write_bytes(size.tobytes() + shot.depth.astype("<f4").tobytes())
        mask = ((shot.owner == 0) * 255).astype(np.uint8)
        cv2.imwrite(str(folder / "masks" / "gt" / f"{model.name}_{i}.png"), mask)
        T = se3.compose(shot.labels.T_cam_obj[0], se3.make(np.eye(3), offset))
        turn = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        angle = float(np.linalg.norm(turn))
        rows.append(" ".join(f"{x:.9f}" for x in (*T[:3, 3], *(turn / max(angle, 1e-12)), angle)))
        visible.append(float(shot.labels.visib_fract[0]))
    camera = {k: getattr(CAMERA, k) for k in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "cam_K.json").write_text(json.dumps(camera))
    (folder / "data.txt").write_text("".join(f"{i / RATE_HZ:.6f}\n" for i in range(FRAMES)))
    (folder / "visib_fract.json").write_text(json.dumps(visible))
    (folder / "gt" / "poses_ycb.txt").write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
