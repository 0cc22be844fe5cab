"""Hard moments for a tracker, rendered in a room with stereo depth: the object is covered or swapped."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Float64
from huepose.scenes import textures
from huepose.scenes.camera import COLOR, RATE_HZ, STEREO
from huepose.scenes.charts import blocks
from huepose.scenes.frame import Stage, shoot
from huepose.scenes.light import random_light
from huepose.scenes.room import room
from huepose.scenes.shapes import printed
from studies.stress.films import AWAY, Seen
from tests.meshes import demo_objects

CAMERA = Camera(500.0, 500.0, 199.5, 149.5, 400, 300).scaled(0.5)

Moving = tuple[Mesh, Float64]
"""A mesh and its poses (N, 4, 4) in camera axes."""


@lru_cache(maxsize=1)
def _room() -> tuple[Moving, ...]:
    return tuple(room(np.random.default_rng(5), 8))


def filmed(things: list[Moving]) -> list[Seen]:
    """Frames of a scene of moving things in the room, labelled for the first; one frame fewer than poses."""
    count = len(things[0][1])
    still = [(mesh, np.broadcast_to(T, (count, 4, 4))) for mesh, T in _room()]
    meshes, paths = zip(*things, *still, strict=True)
    lights = (random_light(np.random.default_rng(9)),) * count
    stage = Stage(meshes, 1, np.array(paths), np.tile(np.eye(4), (count, 1, 1)), lights, CAMERA)
    shots = [shoot(stage, k, 0, COLOR, STEREO) for k in range(count - 1)]
    return [
        Seen(
            RgbdFrame(shot.color, shot.depth, CAMERA, k, round(k * 1e9 / RATE_HZ), 1),
            shot.labels.T_cam_obj[0],
            float(shot.labels.visib_fract[0]),
        )
        for k, shot in enumerate(shots)
    ]


def carried(frames: int) -> Float64:
    """Poses (N, 4, 4) of an object in a hand: about 0.15 m/s and 70 degrees a second."""
    out = np.tile(np.eye(4), (frames, 1, 1))
    for k in range(frames):
        t = k / RATE_HZ
        turn = se3.rotation_exp(
            0.9 * np.array([np.sin(1.1 * t), np.sin(0.8 * t + 1.0), np.sin(0.9 * t + 2.0)])
        )
        sway = np.array([0.05 * np.sin(2.1 * t), 0.03 * np.sin(2.9 * t + 0.5), 0.03 * np.sin(1.7 * t)])
        R = turn @ se3.rotation_exp(np.array([1.5, 0.0, 0.4]))
        out[k] = se3.make(R, np.array([0.0, 0.0, 0.62]) + sway)
    return out


def printed_board(width_m: float, height_m: float) -> Mesh:
    """A printed board, 16 mm thick."""
    rng = np.random.default_rng(12)
    filled = np.ones((1, 1, 1), bool)
    x, y = width_m / 2, height_m / 2
    charts = blocks([-x, x], [-y, y], [-0.008, 0.008], filled, 0.1)
    arts = [textures.sticker("BOARD", 1)] * len(charts)
    return printed(charts, arts, textures.palette(0.07, rng), rng, 256)


def curtain(side_m: float, covers: np.ndarray) -> Moving:
    """A board in front of the image centre in the frames where `covers` (N,) is true, else beside it."""
    path = np.tile(np.eye(4), (len(covers), 1, 1))
    path[:, :3, 3] = np.stack([np.where(covers, 0.0, 0.45), 0.0 * covers, 0.4 + 0.0 * covers], 1)
    return printed_board(side_m, side_m), path


def covered(mesh: Mesh) -> list[Seen]:
    """Forty frames. The object keeps moving; a board covers it from the sixth to the thirteenth."""
    numbers = np.arange(41)
    return filmed([(mesh, carried(41)), curtain(0.24, (numbers >= 5) & (numbers < 13))])


def swapped(mesh: Mesh) -> list[Seen]:
    """Six frames of the box, six behind a board, then a look-alike at its position: the same shape with
    another texture, other colours, and the same words at other positions."""
    at = carried(111)[np.concatenate([np.full(6, 50), np.full(6, 74), np.full(22, 110)])]
    numbers = np.arange(len(at))
    gone, other = at.copy(), at.copy()
    gone[numbers >= 12, :3, 3] = other[numbers < 12, :3, 3] = AWAY[:3, 3]
    board = curtain(0.26, (numbers >= 6) & (numbers < 12))
    return filmed([(mesh, gone), (demo_objects(3)["tea_box"], other), board])
