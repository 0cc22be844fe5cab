"""Plan the built-in scene: paths of all objects, tested for visibility by coarse renderings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.camera import Camera
from huepose.geometry.mesh import Mesh
from huepose.scenes.frame import Stage, labels
from huepose.scenes.light import lights
from huepose.scenes.motion import CALM_S, NEAREST_M, Timing, camera_sway, object_paths, passing
from huepose.scenes.room import bar, room
from huepose.support.errors import InputError

_ATTEMPTS = 12
_EVERY = 5  # frames between those that are looked at before a plan is taken


def plan(objects: Mapping[str, Mesh], seed: int, n_frames: int, camera: Camera, rate_hz: float) -> Stage:
    """The stage of a loop: the first of twelve random plans that meets all conditions, else the best of them.

    Conditions: every object is fully visible in the calm phase, at least 30 % visible in 97 % of all frames,
    never fully hidden, and some object is half hidden at some time. Raises InputError when the objects do not
    fit.
    """
    best: Stage | None = None
    best_score = -np.inf
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, attempt, 30])
        stage = _draft(objects, n_frames, camera, rate_hz, rng)
        score = _score(stage, rate_hz)
        if score > best_score:
            best, best_score = stage, score
        if score >= 1.0:
            break
    assert best is not None
    return best


def _draft(
    objects: Mapping[str, Mesh], n_frames: int, camera: Camera, rate_hz: float, rng: np.random.Generator
) -> Stage:
    timing = Timing.of(n_frames, rate_hz)
    radii = np.array([np.linalg.norm(mesh.vertices, axis=1).max() for mesh in objects.values()])
    try:
        moving = object_paths(radii, camera, timing, rng)
    except RuntimeError as error:
        raise InputError(
            "synthetic scene",
            found=f"{len(radii)} objects of radius {radii.min():.2f} to {radii.max():.2f} m",
            expected="objects that can move side by side in view, for example five of 0.1 m",
            fix="Use fewer or smaller objects.",
        ) from error
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


def _score(stage: Stage, rate_hz: float) -> float:
    """Score of a plan: at least 1 if it meets all conditions, else how nearly."""
    rough = stage.camera.scaled(0.25)
    frames = np.arange(0, len(stage), _EVERY)
    seen: Float64 = np.array([labels(stage, int(i), rough).visib_fract for i in frames])
    calm = seen[frames < CALM_S * rate_hz].min()
    often = (seen >= 0.3).mean(0).min()
    hidden = seen.min()
    return (
        float(min(calm / 0.93, 1.0) + min(often / 0.97, 1.0) + min(hidden / 0.12, 1.0) + (hidden < 0.5)) / 4.0
    )
