"""Modes of a set of voted poses: the densest first, each the weighted mean of its supporters.

The second stage of `voting`, compiled. Means of rotations are chordal (the eigenvector of sum w q q^T,
Markley et al. 2007, doi 10.2514/1.28949), so the signs of quaternions do not matter.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64
from huepose.support.jit import jit

ROUNDS = 60
"""Largest number of steps of the power method; supporters lie close together, so a few are enough."""


def modes_of(
    q: Float32,
    centres: Float32,
    weights: Float32,
    features: Int32,
    radius_m: float,
    angle_rad: float,
    seeds: int,
    limit: int,
) -> tuple[Float64, Float64, Float64]:
    """Scores (M,), unit quaternions xyzw (M, 4) and centres (M, 3) of at most `limit` modes, best first.

    q (E, N, 4): quaternions of all equivalent poses of each vote, the vote itself first; centres (N, 3),
    weights (N,); features (N,) in ascending order. A mode's supporters lie within `radius_m` and `angle_rad`
    of its seed; `seeds` votes are tried as seeds.
    """
    # equal steps over the votes in order of weight: strong and weak votes
    order = np.argsort(-weights, kind="stable")
    tried = np.ascontiguousarray(order[:: max(1, len(order) // seeds)][:seeds])
    cosine = float(np.cos(angle_rad / 2))
    support = _support(q, centres, weights, features, tried, cosine, radius_m)
    return _means(q, centres, weights, tried, support, cosine, radius_m, limit)


def distinct_modes(equals: Float64, centres: Float64, angle_rad: float, radius_m: float, limit: int) -> Int64:
    """Indices of at most `limit` modes, best first, that differ from all better ones by the angle or the
    radius; equals (M, E, 4): quaternions of all equivalent poses of each mode, itself first."""
    return _distinct(equals, centres, float(np.cos(angle_rad / 2)), radius_m, limit)


@jit
def _means(
    q: Float32,
    centres: Float32,
    weights: Float32,
    seeds: Int64,
    support: Float32,
    cosine: float,
    radius: float,
    limit: int,
) -> tuple[Float64, Float64, Float64]:
    scores, quaternions, means = np.empty(limit), np.empty((limit, 4)), np.empty((limit, 3))
    alive = np.ones(seeds.shape[0], np.bool_)
    A, v, u, centre = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(3)
    found = 0
    while found < limit:
        s = -1
        for j in range(seeds.shape[0]):
            if alive[j] and support[j] > 0.0 and (s < 0 or support[j] > support[s]):
                s = j
        if s < 0:
            break
        k = seeds[s]
        A[:] = 0.0
        centre[:] = 0.0
        total = 0.0
        for i in range(q.shape[1]):
            move = 0.0
            for a in range(3):
                move += (centres[i, a] - centres[k, a]) ** 2
            move = 1.0 - move / (radius * radius)
            e, dot = _nearest_equal(q, i, k)
            turn = (dot - cosine) / (1.0 - cosine)
            if move <= 0.0 or turn <= 0.0:
                continue
            w = weights[i] * turn * move
            total += w
            for a in range(3):
                centre[a] += w * centres[i, a]
            for a in range(4):
                for b in range(4):
                    A[a, b] += w * q[e, i, a] * q[e, i, b]
        for a in range(4):
            v[a] = q[0, k, a]
        if total > 0.0:
            _power(A, v, u)
        for a in range(3):
            means[found, a] = centre[a] / total if total > 0.0 else centres[k, a]
        quaternions[found] = v
        scores[found] = support[s]
        found += 1
        for j in range(seeds.shape[0]):
            if alive[j] and _nearest_equal(q, seeds[j], k)[1] >= cosine:
                alive[j] = False
    return scores[:found].copy(), quaternions[:found].copy(), means[:found].copy()


@jit
def _nearest_equal(q: Float32, i: int, k: int) -> tuple[int, float]:
    """Index of the equivalent pose of vote i that is nearest to vote k, and the cosine of half the angle
    between them."""
    best, at = -1.0, 0
    for e in range(q.shape[0]):
        dot = 0.0
        for a in range(4):
            dot += q[e, i, a] * q[0, k, a]
        if abs(dot) > best:
            best, at = abs(dot), e
    return at, best


@jit
def _power(A: Float64, v: Float64, u: Float64) -> None:
    """Power method: iterate the unit vector `v` (4,), in place, to the eigenvector of the largest eigenvalue
    of A; `u` is scratch."""
    for _ in range(ROUNDS):
        length = 0.0
        for a in range(4):
            u[a] = A[a, 0] * v[0] + A[a, 1] * v[1] + A[a, 2] * v[2] + A[a, 3] * v[3]
            length += u[a] * u[a]
        length = np.sqrt(length)
        change = 0.0
        for a in range(4):
            u[a] /= length
            change = max(change, abs(u[a] - v[a]))
            v[a] = u[a]
        if change < 1e-12:
            return


@jit
def _distinct(equals: Float64, centres: Float64, cosine: float, radius: float, limit: int) -> Int64:
    chosen = np.empty(min(limit, equals.shape[0]), np.int64)
    n = 0
    for i in range(equals.shape[0]):
        if n == chosen.shape[0]:
            break
        is_new = True
        for k in range(n):
            j = chosen[k]
            move = 0.0
            for a in range(3):
                move += (centres[i, a] - centres[j, a]) ** 2
            if move >= radius * radius:
                continue
            for e in range(equals.shape[1]):
                dot = 0.0
                for a in range(4):
                    dot += equals[i, e, a] * equals[j, 0, a]
                if abs(dot) > cosine:
                    is_new = False
            if not is_new:
                break
        if is_new:
            chosen[n] = i
            n += 1
    return chosen[:n]


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
    """Support of each seed: sum over features of the strongest vote near it or near an equivalent pose, with
    weights that fall to zero at the radius and the angle."""
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
