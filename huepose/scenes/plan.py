"""Plans the built-in scene: paths of all objects, checked for visibility in coarse renderings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.scenes.camera import RATE_HZ
from huepose.scenes.frame import Stage, labels
from huepose.scenes.light import lights
from huepose.scenes.motion import CALM_S, NEAREST_M, Timing, camera_sway, object_paths, passing
from huepose.scenes.room import bar, room
from huepose.support.errors import InputError

_ATTEMPTS = 12
"""Largest number of drafts; the best one becomes the plan."""

_EVERY = 5  # every N-th frame of a draft is checked


@dataclass(frozen=True)
class _Manner:
    """How objects move. about_middle: about the centres of their bounding boxes instead of their origins;
    haste: factor on speed and path length, see `object_paths`."""

    about_middle: bool
    haste: float


_MANNERS = (_Manner(False, 1.0), _Manner(True, 1.0), _Manner(True, 0.5), _Manner(True, 0.35))
"""The first manner in which the objects have room is used."""


def plan(objects: Mapping[str, Mesh], seed: int, n_frames: int, camera: Camera) -> Stage:
    """The stage of a loop: the first of twelve random plans that meets all conditions, else the best of them.

    Conditions: in the calm phase at least 93 % of every object is visible; every object is at least 30 %
    visible in 97 % of all frames, and never less than 12 %; some object is at some time less than half
    visible. Raises InputError if the objects do not fit.
    """
    for manner in _MANNERS:
        stage = _best(objects, seed, n_frames, camera, manner)
        if stage is not None:
            return stage
    raise _no_room(objects)


def check_room(objects: Mapping[str, Mesh], seed: int, n_frames: int, camera: Camera) -> None:
    """Raises InputError if `plan` does, without rendering anything."""
    timing = Timing.of(n_frames)
    if all(_moving(objects, camera, timing, _generator(seed, 0), manner) is None for manner in _MANNERS):
        raise _no_room(objects)


def _best(
    objects: Mapping[str, Mesh], seed: int, n_frames: int, camera: Camera, manner: _Manner
) -> Stage | None:
    """The best plan in which objects move in this manner; None if they have no room."""
    best: Stage | None = None
    best_score = -np.inf
    for attempt in range(_ATTEMPTS):
        stage = _draft(objects, n_frames, camera, _generator(seed, attempt), manner)
        if stage is None:
            break
        score = _score(stage)
        if score > best_score:
            best, best_score = stage, score
        if score >= 1.0:
            break
    return best


def _generator(seed: int, attempt: int) -> np.random.Generator:
    return np.random.default_rng([seed, attempt, 30])


def _no_room(objects: Mapping[str, Mesh]) -> InputError:
    sizes_cm = [200 * _reach_m(mesh, mesh.centre) for mesh in objects.values()]
    return InputError(
        "synthetic scene",
        found=f"{len(sizes_cm)} objects of {min(sizes_cm):.0f} to {max(sizes_cm):.0f} cm across",
        expected="objects that can move side by side in view, for example five of 25 cm",
        fix="Use fewer or smaller objects.",
    )


def _reach_m(mesh: Mesh, place: Float64) -> float:
    return float(np.linalg.norm(mesh.vertices - place, axis=1).max())


def _moving(
    objects: Mapping[str, Mesh], camera: Camera, timing: Timing, rng: np.random.Generator, manner: _Manner
) -> Float64 | None:
    """Poses T_room_obj (objects, N, 4, 4); None when the objects have no room."""
    middles = [mesh.centre if manner.about_middle else np.zeros(3) for mesh in objects.values()]
    radii = np.array([_reach_m(mesh, middle) for mesh, middle in zip(objects.values(), middles, strict=True)])
    try:
        T_room_middle = object_paths(radii, camera, timing, rng, manner.haste)
    except RuntimeError:
        return None
    if not manner.about_middle:
        return T_room_middle
    T_middle_obj = np.array([se3.make(np.eye(3), -middle) for middle in middles])
    return np.asarray(T_room_middle @ T_middle_obj[:, None], np.float64)


def _draft(
    objects: Mapping[str, Mesh],
    n_frames: int,
    camera: Camera,
    rng: np.random.Generator,
    manner: _Manner,
) -> Stage | None:
    timing = Timing.of(n_frames)
    moving = _moving(objects, camera, timing, rng, manner)
    if moving is None:
        return None
    reach = 0.42 * camera.width / camera.fx / 2 + 0.14
    before = passing(timing, rng, NEAREST_M - 0.15, reach)
    standing = room(rng)
    still = [np.broadcast_to(T, (n_frames, 4, 4)) for _, T in standing]
    return Stage(
        meshes=(*objects.values(), bar(rng), *(mesh for mesh, _ in standing)),
        labelled=len(objects),
        T_room_mesh=np.concatenate([moving, before[None], np.array(still)]),
        T_cam_room=camera_sway(timing, rng),
        lights=tuple(lights(timing, rng)),
        camera=camera,
    )


def _score(stage: Stage) -> float:
    """Score of a plan: 1 if it meets all conditions, less the farther it is from them."""
    rough = stage.camera.scaled(0.25)
    frames = np.arange(0, len(stage), _EVERY)
    visible: Float64 = np.array([labels(stage, int(i), rough).visib_fract for i in frames])
    calm = visible[frames < CALM_S * RATE_HZ].min()
    often = (visible >= 0.3).mean(0).min()
    least = visible.min()
    return (
        float(min(calm / 0.93, 1.0) + min(often / 0.97, 1.0) + min(least / 0.12, 1.0) + (least < 0.5)) / 4.0
    )
