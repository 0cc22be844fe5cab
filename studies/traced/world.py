"""Things that fall and are pushed: MuJoCo, with their convex hulls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from huepose.geometry import Mesh, se3
from huepose.geometry.arrays import Float64, Rng

SPREAD_M = {"apart": 0.26, "heap": 0.17, "pile": 0.10}
"""Radius of the circle over which objects fall; half of the piles fall into an open box."""

STEP_S, STEPS = 0.002, 1600
HZ, START_S = 30, 0.3
"""Frame rate of a film; time before the first push."""

PUSHED, PUSHES_A_SECOND, PUSH_M_S, PUSH_UP_M_S, PUSH_RAD_S = 0.6, 1.5, 0.4, 1.2, 5.0
"""Share of the things that are pushed, and how often; standard deviation of the velocity along the ground,
largest velocity upwards, standard deviation of the angular velocity."""

HULL_POINTS = 400
"""Number of points of a mesh from which its convex hull is made."""


class World:
    """Things that fell on z = 0 or into a bin, as convex hulls."""

    def __init__(self, rng: Rng, things: Sequence[Mesh], spread_m: float, bin_: Mesh | None) -> None:
        import mujoco

        self._model = mujoco.MjModel.from_xml_string(_falling(rng, things, spread_m, bin_))
        self._state = mujoco.MjData(self._model)
        self._bodies = [self._model.body(f"b{k}").id for k in range(len(things))]
        mujoco.mj_step(self._model, self._state, STEPS)

    def poses(self) -> list[Float64]:
        """The current poses (4, 4) of all things."""
        at = self._state
        return [se3.make(at.xmat[i].reshape(3, 3), at.xpos[i].copy()) for i in self._bodies]

    def film(self, rng: Rng, frames: int) -> Iterator[list[Float64]]:
        """The poses in each frame, while some things are sometimes pushed."""
        import mujoco

        moving = np.flatnonzero(rng.uniform(size=len(self._bodies)) < PUSHED)
        done = 0
        for k in range(frames):
            yield self.poses()
            for j in moving:
                if k >= START_S * HZ and rng.uniform() < PUSHES_A_SECOND / HZ:
                    push = [*rng.normal(0, PUSH_M_S, 2), rng.uniform(0, PUSH_UP_M_S)]
                    self._state.qvel[6 * j : 6 * j + 6] = [*push, *rng.normal(0, PUSH_RAD_S, 3)]
            until = round((k + 1) / HZ / STEP_S)
            mujoco.mj_step(self._model, self._state, until - done)
            done = until


def _falling(rng: Rng, things: Sequence[Mesh], spread_m: float, bin_: Mesh | None) -> str:
    """MuJoCo's description of the things in the air, one above the other."""
    meshes, bodies, places = "", "", list[Float64]()
    for k, mesh in enumerate(things):
        v = mesh.vertices
        some = np.concatenate(
            [v[rng.choice(len(v), min(HULL_POINTS, len(v)), False)], v[v.argmin(0)], v[v.argmax(0)]]
        )
        meshes += f'<mesh name="m{k}" vertex="{" ".join(f"{x:.5f}" for x in some.ravel())}"/>'
        for _ in range(40):
            angle, away = rng.uniform(0, 2 * np.pi), spread_m * np.sqrt(rng.uniform())
            place = away * np.array([np.cos(angle), np.sin(angle)])
            if spread_m < SPREAD_M["apart"] or all(np.linalg.norm(place - p) > 0.12 for p in places):
                break
        places.append(place)
        height = 0.12 + (0.02 if spread_m == SPREAD_M["apart"] else 0.11) * k
        turn = rng.normal(size=4)
        bodies += (
            f'<body name="b{k}" pos="{place[0]:.4f} {place[1]:.4f} {height:.4f}" '
            f'quat="{" ".join(f"{x:.5f}" for x in turn / np.linalg.norm(turn))}"><freejoint/>'
            f'<geom type="mesh" mesh="m{k}" density="500" friction="0.8 0.02 0.01" condim="6"/></body>'
        )
    walls = ""
    if bin_ is not None:
        x, y, z = np.ptp(bin_.vertices, axis=0) / 2.0
        for half, at in (
            ((0.006, y), (x, 0)),
            ((0.006, y), (-x, 0)),
            ((x, 0.006), (0, y)),
            ((x, 0.006), (0, -y)),
        ):
            walls += f'<geom type="box" size="{half[0]} {half[1]} {z}" pos="{at[0]} {at[1]} {z}"/>'
    return (
        f'<mujoco><option timestep="{STEP_S}" integrator="implicitfast"/><asset>{meshes}</asset><worldbody>'
        f'<geom type="plane" size="2 2 0.1" friction="0.9 0.02 0.02" condim="6"/>{walls}{bodies}'
        "</worldbody></mujoco>"
    )
