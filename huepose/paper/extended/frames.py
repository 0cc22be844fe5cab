"""A colour pair on a surface is a whole coordinate frame: one match determines a pose.

A ridge point has a position, a surface normal and the direction across the edge; the colours distinguish the
two sides. So a single match of a scene pair with a model pair roughly determines all six degrees of freedom,
while a triangle needs three points of three classes. This uses all information of the paper's features, costs
little, and works with two colours. The votes are clustered with those of triangles and point pairs.
"""

from __future__ import annotations

import numpy as np

from huepose.colorpair.similarity import shapes
from huepose.colorpair.types import SurfacePairs
from huepose.geometry.arrays import Float32, Int32
from huepose.paper.classes import exchange, pair_cost
from huepose.paper.votes import Votes
from huepose.support.jit import jit

MODEL_PAIRS = 2500
"""Largest number of the model's pairs that are compared."""

MATCHES = 80
"""Largest number of matches of one scene pair."""

LEAST_SIMILARITY = 0.3
"""A match with less similarity does not vote."""

SHARPNESS = 3.0
"""Exponent on the similarity where matches share a pair's vote."""


def frame_votes(scene: SurfacePairs, model: SurfacePairs) -> Votes:
    """Poses T_cam_obj from single matches; `scene` in camera axes, `model` in the object's."""
    if not len(scene) or not len(model):
        return Votes.empty()
    model = model[:: -(-len(model) // MODEL_PAIRS)]
    return Votes(
        *_vote(
            shapes(scene.colors),
            _frames(scene),
            scene.points,
            shapes(model.colors),
            _frames(model),
            np.ascontiguousarray(model.points),
        )
    )


def _frames(pairs: SurfacePairs) -> Float32:
    """Rotations (N, 3, 3) float32 whose columns are tangent, edge direction and normal."""
    n = pairs.normals
    t = pairs.tangents - (pairs.tangents * n).sum(1, keepdims=True) * n
    t /= np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-9)
    return np.ascontiguousarray(np.stack([t, np.cross(n, t), n], 2), np.float32)


@jit
def _vote(
    x: Float32,
    frames: Float32,
    points: Float32,
    y: Float32,
    model_frames: Float32,
    model_points: Float32,
) -> tuple[Float32, Float32, Float32, Int32]:
    room = points.shape[0] * MATCHES
    out_R = np.empty((room, 3, 3), np.float32)
    out_t = np.empty((room, 3), np.float32)
    out_w = np.empty(room, np.float32)
    out_f = np.empty(room, np.int32)
    count = 0
    m = model_points.shape[0]
    farthest = -np.log(LEAST_SIMILARITY)
    found = np.empty(2 * m, np.int32)
    cost = np.empty(2 * m, np.float32)
    exchanged = np.empty(x.shape[1], np.float32)
    for i in range(points.shape[0]):
        # the pair as it is, and with its sides exchanged: its frame is then rotated about the normal
        exchange(x[i], exchanged)
        near = 0
        total = 0.0
        for j in range(m):
            for way in range(2):
                z = exchanged if way else x[i]
                c = pair_cost(z, y[j])
                if c < farthest:
                    found[near] = j + way * m
                    cost[near] = c
                    total += np.exp(-SHARPNESS * c)
                    near += 1
        order = np.argsort(cost[:near])
        for k in range(min(MATCHES, near)):
            j = found[order[k]]
            flip = np.float32(1.0) if j < m else np.float32(-1.0)
            j = j % m
            for a in range(3):
                moved = np.float32(0.0)
                for b in range(3):
                    r = (
                        flip * frames[i, a, 0] * model_frames[j, b, 0]
                        + flip * frames[i, a, 1] * model_frames[j, b, 1]
                        + frames[i, a, 2] * model_frames[j, b, 2]
                    )
                    out_R[count, a, b] = r
                    moved += r * model_points[j, b]
                out_t[count, a] = points[i, a] - moved
            out_w[count] = np.exp(-SHARPNESS * cost[order[k]]) / total
            out_f[count] = i
            count += 1
    return out_R[:count].copy(), out_t[:count].copy(), out_w[:count].copy(), out_f[:count].copy()
