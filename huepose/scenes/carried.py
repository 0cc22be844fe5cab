"""An object that moves and rotates fast over a table, as in the sequences of Fast-YCB."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float64, Rng
from huepose.scenes.camera import RATE_HZ
from huepose.scenes.frame import Stage
from huepose.scenes.light import Light, random_light
from huepose.scenes.motion import positions, rotations
from huepose.scenes.room import Placed, sheet, table_top, wallpaper

CAMERA = Camera(614.0, 614.0, 319.5, 239.5, 640, 480)
FRAMES = 60
OTHERS = 5
"""Number of objects on the ground."""

BEHIND = 0.35
"""Share of the sequences in which another object is between camera and object."""


def staged(mesh: Mesh, others: Sequence[Mesh], rng: Rng, frames: int = FRAMES) -> Stage:
    """The object on its path, the ground, other objects, and a light."""
    pixel, middle_m = rng.uniform((230, 170), (410, 310)), rng.uniform(0.5, 0.8)
    path = carried(rng, CAMERA.backproject(pixel[None], np.array([middle_m]))[0], mesh.centre, frames)
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
    light = random_strong_light(rng)
    n = len(path)
    paths = np.array([path, *(np.broadcast_to(T, (n, 4, 4)) for _, T in standing)])
    meshes = (mesh, *(other for other, _ in standing))
    return Stage(meshes, 1, paths, np.tile(np.eye(4), (n, 1, 1)), (light,) * n, CAMERA)


def random_strong_light(rng: Rng) -> Light:
    """A random light of varied strength: white surfaces may be overexposed."""
    light = random_light(rng)
    key, sky = light.key * np.exp(rng.uniform(-0.9, 0.9)), light.sky * np.exp(rng.uniform(-0.7, 0.7))
    return replace(light, key=float(key), sky=float(sky))


def carried(rng: Rng, middle_cam: Float64, centre_obj: Float64, frames: int = FRAMES) -> Float64:
    """Poses T_cam_obj (frames + 1, 4, 4) of an object that moves and rotates fast around `middle_cam`
    (3,)."""
    k, phase = int(rng.integers(4, 6)), np.linspace(0.0, 0.999, frames + 1)
    place = positions(rng.normal(0, 1, (k, 3)) * (1.0, 0.7, 0.6), phase)
    place -= place.mean(0)
    fastest = float(np.linalg.norm(np.diff(place, axis=0), axis=1).max()) * RATE_HZ
    place = middle_cam + place * (rng.uniform(0.45, 0.75) / fastest)
    turns, base = rng.normal(0, 1, (k, 3)), Rotation.random(random_state=int(rng.integers(1 << 30)))
    limit, low, high = np.radians(rng.uniform(260, 380)), 0.0, 4.0

    def rotated(amplitude: float) -> Float64:
        return rotations((Rotation.from_rotvec(amplitude * turns) * base).as_matrix(), phase)

    for _ in range(12):
        half = (low + high) / 2.0
        R = rotated(half)
        steps = [np.linalg.norm(Rotation.from_matrix(R[i + 1] @ R[i].T).as_rotvec()) for i in range(frames)]
        low, high = (half, high) if max(steps) * RATE_HZ < limit else (low, half)
    R = rotated(low)
    path = np.tile(np.eye(4), (frames + 1, 1, 1))
    path[:, :3, :3], path[:, :3, 3] = R, place - R @ centre_obj
    return path


def _somewhere(mesh: Mesh, pixel: Float64, depth_m: float, rng: Rng) -> Placed:
    R = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    centre = CAMERA.backproject(pixel[None], np.array([depth_m]))[0]
    return mesh, se3.make(R, centre - R @ mesh.centre)
