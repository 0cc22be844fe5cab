"""Start poses from shape alone, for when colours are not enough: few pairs, one colour, a blurred or distant
object.

Evenly spaced rotations are placed so that the part of the surface that each shows lies at the mask's depth.
Those that agree best with depth are start poses for the registration.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.se3 import angles_to
from huepose.model.types import ReferenceModel, Surface
from huepose.paper.extended.plausible import plausible
from huepose.paper.votes import Votes

LEVEL, ROLLS = 1, 16
"""Level of the icosphere of views, and number of rolls about the viewing ray: any rotation is at most about
20 degrees from one of them."""

DISTINCT_DEG = 20.0
"""Of rotations that differ by less, one is kept."""

POINTS = 400
"""Largest number of a mask's pixels whose depth gives the object's position."""


def shape_hypotheses(model: ReferenceModel, frame: RgbdFrame, mask: Bool, count: int) -> Float64:
    """The `count` most plausible different start poses (K, 4, 4) in a mask (H, W), best first; none without
    depth."""
    v, u = np.nonzero(mask & (frame.depth > 0))
    if not len(v):
        return np.zeros((0, 4, 4))
    step = -(-len(v) // POINTS)
    chosen = np.stack([u[::step], v[::step]], 1)
    depths = frame.depth[chosen[:, 1], chosen[:, 0]]
    middle = np.median(frame.camera.backproject(chosen.astype(np.float64), depths), axis=0)
    rotations, views = _rotations()
    shown = _visible_middles(model.surface, icosphere.directions(LEVEL))[views]
    translations = middle - np.einsum("nij,nj->ni", rotations, shown)
    votes = Votes(
        rotations.astype(np.float32),
        translations.astype(np.float32),
        np.ones(len(rotations), np.float32),
        np.arange(len(rotations), dtype=np.int32),
    )
    votes = plausible(votes, model.surface, frame.depth, mask, frame.camera, model.diameter_m)
    out: list[Float64] = []
    for k in np.argsort(-votes.weights, kind="stable"):
        if len(out) >= count:
            break
        R = votes.rotations[k].astype(np.float64)
        if out and angles_to(np.stack([T[:3, :3] for T in out]), R).min() < np.radians(DISTINCT_DEG):
            continue
        out.append(se3.make(R, votes.translations[k]))
    return np.array(out).reshape(-1, 4, 4)


@lru_cache(maxsize=1)
def _rotations() -> tuple[Float64, np.ndarray]:
    """Evenly spaced rotations R_cam_obj (N, 3, 3), and the index (N,) of the view of each."""
    out, views = [], []
    for index, direction in enumerate(icosphere.directions(LEVEL)):
        for roll in range(ROLLS):
            about_ray = se3.rotation_exp(np.array([0.0, 0.0, 2 * np.pi * roll / ROLLS]))
            out.append(about_ray @ icosphere.look_at(direction))
            views.append(index)
    return np.stack(out), np.array(views)


def _visible_middles(surface: Surface, directions: Float64) -> Float32:
    """Median (V, 3) of the surface samples that are visible from each direction (V, 3)."""
    out = np.empty((len(directions), 3), np.float32)
    for i, k in enumerate((directions @ surface.directions.T).argmax(1)):
        visible = surface.visible[surface.offsets[k] : surface.offsets[k + 1]][:150]
        out[i] = np.median(surface.points[visible], axis=0) if len(visible) else 0.0
    return out
