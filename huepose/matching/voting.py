"""From thousands of weak poses to a few good ones: two-stage Hough voting, coarse to fine (paper, section
III-C).

First the position: cells of a tenth of the diameter collect votes for the object's centre, neighbours
included. Then, inside the best cells, the rotation: votes within a geodesic radius and a distance of each
other support one another. In both stages a scene feature counts once, with its strongest vote, so that an
ambiguous feature cannot fill a cell alone. Modes are the weighted means of their supporters (chordal mean,
free of quaternion signs), and suppress what is near them in pose space.

Of an object that looks the same after a turn every pose has equals. Votes for equals support each other, and
each is replaced by the equal nearest to the mode before means are taken: the mean of a pose and its half
turn is neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float32, Float64, Int32, Int64
from huepose.geometry.rotations import angles_to
from huepose.matching.types import Hypothesis, Votes
from huepose.support.jit import jit


@dataclass(frozen=True)
class VotingConfig:
    """cell: of the centre's position, and radius of a mode's support, in diameters; angle_deg: radius of a
    mode's support; cells: searched; modes: of one cell; seeds: tried in one cell; members: votes looked at
    in one cell; distinct_deg, distinct: hypotheses nearer than both (degrees, diameters) are one;
    hypotheses: returned."""

    cell: float = 0.1
    angle_deg: float = 20.0
    cells: int = 8
    modes: int = 10
    seeds: int = 120
    members: int = 2500
    distinct_deg: float = 15.0
    distinct: float = 0.07
    hypotheses: int = 60


def cluster(
    votes: Votes,
    centre_obj: Float,
    diameter_m: float,
    source: str,
    config: VotingConfig | None = None,
    equivalents: Float | None = None,
) -> list[Hypothesis]:
    """The densest poses among the votes, best first; `centre_obj` (3,) is the point whose position is voted
    for; `equivalents` (E, 4, 4), identity first: turns after which shape and print look the same.

    The score is the summed weight of a mode's supporters, each scene feature counted once. Of equal poses
    one is returned.
    """
    config = config or VotingConfig()
    if not len(votes):
        return []
    turns = np.eye(4)[None] if equivalents is None else np.asarray(equivalents, np.float64)
    # the one point that no equal pose moves
    c = np.asarray(turns[:, :3, :3] @ np.asarray(centre_obj, np.float64) + turns[:, :3, 3]).mean(0)
    centres = votes.rotations @ c.astype(np.float32) + votes.translations
    quaternions = np.stack([_quaternions(votes.rotations @ t[:3, :3].astype(np.float32)) for t in turns])
    cell_m = config.cell * diameter_m
    found: list[tuple[float, Float64, Float64]] = []
    for members in dense_cells(centres, votes.weights, votes.features, cell_m, config.cells):
        if len(members) > config.members:
            members = members[:: -(-len(members) // config.members)]
        found += _modes(
            np.ascontiguousarray(quaternions[:, members]),
            centres[members],
            votes.weights[members],
            votes.features[members],
            cell_m,
            config,
        )
    found.sort(key=lambda mode: -mode[0])
    kept: list[tuple[float, Float64, Float64]] = []
    for mode in found:
        if len(kept) >= config.hypotheses:
            break
        if kept:
            others = np.stack([m[1] for m in kept])
            angles = np.min([angles_to(others, mode[1] @ t[:3, :3]) for t in turns], axis=0)
            moves = np.linalg.norm(np.stack([m[2] for m in kept]) - mode[2], axis=1)
            if ((angles < np.radians(config.distinct_deg)) & (moves < config.distinct * diameter_m)).any():
                continue
        kept.append(mode)
    return [Hypothesis(se3.make(R, centre - R @ c), score, source) for score, R, centre in kept]


def dense_cells(
    centres: Float32, weights: Float32, features: Int32, cell_m: float, count: int
) -> list[Int64]:
    """The votes (indices) in and around the cells with most votes, best cell first; no two chosen cells
    touch."""
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


def _modes(
    q: Float32, centres: Float32, weights: Float32, features: Int32, radius_m: float, config: VotingConfig
) -> list[tuple[float, Float64, Float64]]:
    """Modes (score, R, centre) among the votes of one cell; q (E, N, 4): of all equal poses of each vote."""
    angle = np.radians(config.angle_deg)
    # even steps over the votes in order of weight: strong ones and weak ones
    order = np.argsort(-weights, kind="stable")
    seeds = np.ascontiguousarray(order[:: max(1, len(order) // config.seeds)][: config.seeds])
    support = _support(q, centres, weights, features, seeds, float(np.cos(angle / 2)), radius_m)
    out: list[tuple[float, Float64, Float64]] = []
    alive = np.ones(len(seeds), bool)
    for _ in range(config.modes):
        s = int(np.where(alive, support, -1.0).argmax())
        if not alive[s] or support[s] <= 0:
            break
        k = seeds[s]
        # the equal pose of every vote that is nearest to the mode
        cosines = np.abs(q @ q[0, k])
        nearest = cosines.argmax(0)
        like = q[nearest, np.arange(q.shape[1])]
        near, w = _members(like, centres, weights, k, angle, radius_m)
        mean = np.asarray(w @ centres[near].astype(np.float64) / w.sum())
        out.append((float(support[s]), _mean_rotation(like[near], w), mean))
        alive &= cosines.max(0)[seeds] < np.cos(angle / 2)
    return out


def _members(
    q: Float32, centres: Float32, weights: Float32, k: int, angle: float, radius_m: float
) -> tuple[Int64, Float64]:
    """The votes near vote k, and their weights, smaller towards the rim; k itself is always there."""
    rim = np.cos(angle / 2)
    turn = (np.abs(q @ q[k]) - rim) / (1 - rim)
    move = ((centres - centres[k]) ** 2).sum(1) / radius_m**2
    w = weights * np.maximum(turn, 0) * np.maximum(1 - move, 0)
    near = np.flatnonzero(w > 0)
    return (near, w[near].astype(np.float64)) if len(near) else (np.array([k]), np.ones(1))


def _mean_rotation(q: Float32, w: Float64) -> Float64:
    """Chordal mean (3, 3) of unit quaternions (N, 4): see `geometry.rotations.mean_rotation`."""
    _, vectors = np.linalg.eigh((q * w[:, None]).T @ q)
    return se3.rotation_from_quaternion(vectors[:, -1])


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
    """Sum over features of the strongest vote of each feature in each cell; features come in order."""
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


@jit
def _support(
    q: Float32,
    centres: Float32,
    weights: Float32,
    features: Int32,
    seeds: Int64,
    cosine: float,
    radius: float,
) -> Float32:
    """Support of each seed: the strongest vote of each feature near it or near an equal pose, smaller towards
    the rim."""
    out = np.zeros(seeds.shape[0], np.float32)
    r2 = np.float32(radius * radius)
    for s in range(seeds.shape[0]):
        k = seeds[s]
        a, b, c, d = q[0, k, 0], q[0, k, 1], q[0, k, 2], q[0, k, 3]
        total = np.float32(0.0)
        current = np.int32(-1)
        counted = np.float32(0.0)
        for i in range(q.shape[1]):
            dot = np.float32(0.0)
            for e in range(q.shape[0]):
                dot = max(dot, abs(a * q[e, i, 0] + b * q[e, i, 1] + c * q[e, i, 2] + d * q[e, i, 3]))
            if dot < cosine:
                continue
            x, y, z = (
                centres[i, 0] - centres[k, 0],
                centres[i, 1] - centres[k, 1],
                centres[i, 2] - centres[k, 2],
            )
            move = (x * x + y * y + z * z) / r2
            if move > 1.0:
                continue
            if features[i] != current:
                current = features[i]
                counted = np.float32(0.0)
            w = weights[i] * (dot - cosine) / (1 - cosine) * (1 - move)
            if w > counted:
                total += w - counted
                counted = w
        out[s] = total
    return out
