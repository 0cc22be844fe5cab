"""Cluster thousands of weak pose votes to a few hypotheses: two-stage Hough voting, coarse to fine (paper,
III-C).

First the position: cells of a tenth of the diameter collect votes for the object's centre, with their
neighbours. Then, inside the best cells, the rotation: votes within an angle and a distance of each other
support one another. In both stages a scene feature counts once, with its strongest vote, so that an ambiguous
feature cannot fill a cell alone. Modes are weighted means of their supporters (chordal mean, independent of
quaternion signs); non-maximum suppression removes modes near better ones.

A pose of a symmetric object has equivalent poses. Votes for equivalent poses support each other, and each is
replaced by the equivalent pose nearest to the mode before means are taken: the mean of a pose and the same
pose rotated by 180 degrees would be neither of the two.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64, Int32, Int64
from huepose.paper.modes import distinct_modes, modes_of
from huepose.paper.votes import Votes
from huepose.support.jit import jit

CELL, ANGLE_DEG = 0.1, 20.0
"""Radii of a mode's support, in diameters and degrees; the first is also the side of a cell of positions."""

CELLS, MEMBERS = 8, 2500
"""Largest numbers of cells that are searched, and of votes that are used in each."""

SEEDS, MODES = 120, 10
"""Largest numbers of seeds that are tried in one cell, and of its modes."""

DISTINCT, DISTINCT_DEG = 0.07, 15.0
"""Hypotheses nearer than both (diameters, degrees) are one."""

HYPOTHESES = 60
"""Largest number of hypotheses that are returned."""

NO_POSES = np.zeros((0, 4, 4)), np.zeros(0)


def cluster(
    votes: Votes,
    centre_obj: Float,
    diameter_m: float,
    equivalents: Float | None = None,
) -> tuple[Float64, Float64]:
    """The densest poses (K, 4, 4) among the votes, best first, and their scores (K,).

    centre_obj (3,): the point whose position is voted for; equivalents (E, 4, 4), identity first: rotations
    after which shape and texture look the same. The score is the summed weight of a mode's supporters, each
    scene feature counted once. Of equivalent poses one is returned.
    """
    if not len(votes):
        return NO_POSES
    symmetries = np.eye(4)[None] if equivalents is None else np.asarray(equivalents, np.float64)
    # the mean of the centre over the equivalent rotations: none of them moves it
    c = np.asarray(symmetries[:, :3, :3] @ np.asarray(centre_obj, np.float64) + symmetries[:, :3, 3]).mean(0)
    centres = votes.rotations @ c.astype(np.float32) + votes.translations
    quaternions = np.stack([_quaternions(votes.rotations @ t[:3, :3].astype(np.float32)) for t in symmetries])
    cell_m, angle = CELL * diameter_m, float(np.radians(ANGLE_DEG))
    found = []
    for members in dense_cells(centres, votes.weights, votes.features, cell_m, CELLS):
        if len(members) > MEMBERS:
            members = members[:: -(-len(members) // MEMBERS)]
        found.append(
            modes_of(
                np.ascontiguousarray(quaternions[:, members]),
                centres[members],
                votes.weights[members],
                votes.features[members],
                cell_m,
                angle,
                SEEDS,
                MODES,
            )
        )
    if not found:
        return NO_POSES
    scores, rotations, places = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(-scores, kind="stable")
    scores, rotations, places = scores[order], rotations[order], places[order]
    by_symmetry = np.stack([se3.quaternion_from_rotation(t[:3, :3]) for t in symmetries])
    kept = distinct_modes(
        _products(rotations, by_symmetry),
        places,
        float(np.radians(DISTINCT_DEG)),
        DISTINCT * diameter_m,
        HYPOTHESES,
    )
    poses = []
    for k in kept:
        R = se3.rotation_from_quaternion(rotations[k])
        poses.append(se3.make(R, places[k] - R @ c))
    return np.array(poses).reshape(-1, 4, 4), scores[kept]


def _products(a: Float64, b: Float64) -> Float64:
    """Quaternions xyzw (N, M, 4) of rotations b (M, 4) followed by rotations a (N, 4)."""
    x, w = a[:, None, :3], a[:, None, 3:]
    y, v = b[None, :, :3], b[None, :, 3:]
    axis = w * y + v * x + np.cross(x, y)
    return np.ascontiguousarray(np.concatenate([axis, w * v - (x * y).sum(-1, keepdims=True)], -1))


def dense_cells(
    centres: Float32, weights: Float32, features: Int32, cell_m: float, count: int
) -> list[Int64]:
    """The votes (indices) in and around the cells with most votes, best cell first; no two chosen cells are
    neighbours."""
    low = np.percentile(centres, 1, axis=0).astype(np.float32) - 2 * cell_m
    high = np.percentile(centres, 99, axis=0).astype(np.float32) + 2 * cell_m
    size = np.minimum(np.ceil((high - low) / cell_m).astype(np.int64) + 1, 64)
    cells = np.floor((centres - low) / np.float32(cell_m)).astype(np.int64)
    inside = ((cells >= 1) & (cells < size - 1)).all(1)
    flat = np.where(inside, (cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2], -1)
    total = _cell_votes(flat, weights, features, int(size.prod())).reshape(size)
    around = total.copy()
    for axis in range(3):
        around = around + np.roll(around, 1, axis) + np.roll(around, -1, axis)
    chosen: list[Int64] = []
    for _ in range(count):
        k = np.array(np.unravel_index(int(around.argmax()), around.shape))
        if around[tuple(k)] <= 0:
            break
        near = (np.abs(cells - k) <= 1).all(1) & inside
        chosen.append(np.flatnonzero(near))
        a, b = np.maximum(k - 1, 0), k + 2
        around[a[0] : b[0], a[1] : b[1], a[2] : b[2]] = 0.0
    return chosen


def _quaternions(R: Float32) -> Float32:
    """Unit quaternions xyzw (N, 4) of rotations (N, 3, 3), by the largest of the four components."""
    m = np.asarray(R, np.float64)
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    yz, zx, xy = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    sxy, szx, syz = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    rows = np.stack(
        [
            np.stack([1 + xx - yy - zz, sxy, szx, yz], 1),
            np.stack([sxy, 1 - xx + yy - zz, syz, zx], 1),
            np.stack([szx, syz, 1 - xx - yy + zz, xy], 1),
            np.stack([yz, zx, xy, 1 + xx + yy + zz], 1),
        ],
        1,
    )
    best = np.einsum("nkk->nk", rows).argmax(1)
    q = rows[np.arange(len(m)), best]
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True), np.float32)


@jit
def _cell_votes(cells: Int64, weights: Float32, features: Int32, count: int) -> Float32:
    """Sum over features of the strongest vote of each feature in each cell; features in ascending order."""
    total = np.zeros(count, np.float32)
    owner = np.full(count, -1, np.int32)
    counted = np.zeros(count, np.float32)
    for i in range(cells.shape[0]):
        k = cells[i]
        if k < 0:
            continue
        if owner[k] != features[i]:
            owner[k] = features[i]
            counted[k] = 0.0
        if weights[i] > counted[k]:
            total[k] += weights[i] - counted[k]
            counted[k] = weights[i]
    return total
