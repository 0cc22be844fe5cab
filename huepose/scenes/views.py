"""Single labelled frames of given objects in clutter: for calibration and tests."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from huepose.datasets.types import GroundTruth, Sample
from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Float, Float64
from huepose.scenes.frame import Stage, shoot, visible_mask
from huepose.scenes.light import random_light
from huepose.scenes.motion import NEAREST_M, TABLE_M, UP_ROOM
from huepose.scenes.plan import CAMERA
from huepose.scenes.room import clutter, room
from huepose.scenes.sensor import COLOR, STEREO, StereoSensor


def random_view(
    meshes: Mapping[str, Mesh],
    seed: int,
    camera: Camera = CAMERA,
    *,
    occluders: int = 3,
    distance_m: tuple[float, float] = (0.5, 1.1),
    depth_sensor: StereoSensor | None = STEREO,
) -> Sample:
    """One frame of all `meshes` at random poses, no two in the same place, over a table with clutter.

    `occluders` things float between the camera and an object each, so that some are partly hidden; light,
    noise and everything else follow `seed`. Truth is exact; `mask()` of it renders.
    """
    rng = np.random.default_rng([seed, 50])
    radii = [float(np.linalg.norm(mesh.vertices, axis=1).max()) for mesh in meshes.values()]
    centres: list[Float64] = []
    for k, radius in enumerate(radii):
        centres.append(_free_place(camera, distance_m, radius, centres, radii[:k], rng))
    placed = [
        (mesh, se3.make(Rotation.random(random_state=rng).as_matrix(), centre))
        for mesh, centre in zip(meshes.values(), centres, strict=True)
    ]
    for _ in range(occluders if placed else 0):
        hidden = int(rng.integers(len(meshes)))
        aside = rng.normal(0, 0.75 * radii[hidden], 3) * (1, 1, 0)
        spot = (centres[hidden] + aside) * rng.uniform(0.62, 0.8)
        placed.append((clutter(rng), se3.make(Rotation.random(random_state=rng).as_matrix(), spot)))
    placed += room(rng)
    stage = Stage(
        meshes=tuple(mesh for mesh, _ in placed),
        labelled=len(meshes),
        T_room_mesh=np.array([T for _, T in placed])[:, None],
        T_cam_room=np.eye(4)[None],
        lights=(random_light(rng),),
        camera=camera,
    )
    shot = shoot(stage, 0, seed, COLOR, depth_sensor)
    truths = tuple(
        GroundTruth(
            instance=k,
            object=name,
            T_cam_obj=shot.labels.T_cam_obj[k],
            visib_fract=float(shot.labels.visib_fract[k]),
            box_visib=shot.labels.box_visib[k],
            mask_loader=partial(visible_mask, stage, 0, k),
        )
        for k, name in enumerate(meshes)
    )
    return Sample(RgbdFrame(shot.color, shot.depth, camera), truths, "random", seed)


def _free_place(
    camera: Camera,
    distance_m: tuple[float, float],
    radius: float,
    centres: list[Float64],
    radii: list[float],
    rng: np.random.Generator,
) -> Float64:
    """A point (3,) in view that is clear of the others, or as clear as many draws allow."""
    best, best_gap = np.array([0.0, 0.0, NEAREST_M]), -np.inf
    for _ in range(300):
        pixel = rng.uniform(0.12, 0.88, 2) * (camera.width, camera.height)
        point = camera.backproject(pixel, np.array(rng.uniform(*distance_m)))
        gap = _gap(point, radius, centres, radii)
        if gap > best_gap:
            best, best_gap = point, gap
        if gap > 0:
            break
    return best


def _gap(point: Float, radius: float, centres: list[Float64], radii: list[float]) -> float:
    """The least room, m, between a ball there and the other balls and the table."""
    others = [float(np.linalg.norm(point - c)) - radius - r for c, r in zip(centres, radii, strict=True)]
    return min([float(point @ UP_ROOM) + TABLE_M - radius, *others])
