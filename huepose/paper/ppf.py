"""Point pair features with classes: the fallback where fewer than three classes are visible (paper, III-C).

Drost et al. 2010 (doi 10.1109/CVPR.2010.5540108): two oriented points have a distance and three angles that
no rigid motion changes. If a scene pair matches a pair in the table, only the rotation `alpha` about the
normal is unknown; the pairs vote for it, and for the model point. Here both points also have their colour
class: so pairs of flat objects differ although all have the same angles. Pairs that lie in one plane *and*
have one class are left out. The method is covered by EP 2385483 and US 8830229 in some countries: it can be
switched off wherever poses are estimated.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int, Int32, Int64, UInt8
from huepose.model.types import PaperTables
from huepose.paper.cloud import MAX_BINS, MAX_CLASSES, ClassifiedCloud, sparse
from huepose.paper.votes import Votes
from huepose.support.jit import jit

BIN, ANGLES = 0.05, 12
"""Width of a bin of the distance, in diameters; number of bins in 180 degrees."""

MIN_DISTANCE = 0.15
"""Smallest distance between the points of a pair, in diameters."""

MODEL_POINTS, ROWS = 700, 150_000
"""Largest number of model points that make pairs, and of rows of the table."""

REFERENCES, PARTNERS = 40, 100
"""Reference points of a scene, and points paired with each."""

PEAKS = 0.9
"""A peak counts if it has this share of the votes of the highest one."""


def build_ppf(cloud: ClassifiedCloud, diameter_m: float) -> tuple[Int64, Int32, Float32]:
    """Keys (Q,) int64, sorted; pairs (Q, 2) int32 into the cloud; alpha (Q,) float32 radians.

    A pair is made of points that one camera can see together; if there are more than `ROWS`, a uniform random
    sample of them is kept.
    """
    rng = np.random.default_rng(0)
    spacing = 0.03
    chosen: Int = np.arange(len(cloud))
    while len(chosen) > MODEL_POINTS:
        chosen = sparse(cloud, spacing * diameter_m)
        spacing *= 1.2
    i, j = (a.ravel() for a in np.meshgrid(chosen, chosen, indexing="ij"))
    distance = np.linalg.norm(cloud.points[i] - cloud.points[j], axis=1)
    facing = (cloud.normals[i] * cloud.normals[j]).sum(1)
    usable = (distance > MIN_DISTANCE * diameter_m) & (facing > -0.5)
    d = (cloud.points[j] - cloud.points[i]) / np.maximum(distance, 1e-12)[:, None]
    flat = (facing > 0.95) & (np.abs((d * cloud.normals[i]).sum(1)) < 0.1)
    usable &= ~(flat & (cloud.classes[i] == cloud.classes[j]))
    rows = np.flatnonzero(usable)
    if len(rows) > ROWS:
        rows = np.sort(rng.choice(rows, ROWS, replace=False))
    first, second = i[rows].astype(np.int32), j[rows].astype(np.int32)
    keys, alpha = _features(cloud.points, cloud.normals, cloud.classes, first, second, BIN * diameter_m)
    order = np.argsort(keys, kind="stable")
    return keys[order], np.stack([first, second], 1)[order].astype(np.int32), alpha[order]


def ppf_votes(
    scene: ClassifiedCloud, tables: PaperTables, diameter_m: float, rng: np.random.Generator
) -> Votes:
    """Poses from the peaks of the votes of some reference points of the scene's classified cloud (camera
    axes); diameter_m: the model's."""
    if not len(tables.ppf_keys) or len(scene) < 2:
        return Votes.empty()
    p = np.maximum(scene.weights.astype(np.float64), 1e-6)
    count = min(REFERENCES, len(scene))
    references = rng.choice(len(scene), count, replace=False, p=p / p.sum()).astype(np.int32)
    partners = rng.choice(len(scene), min(PARTNERS, len(scene)), replace=False, p=p / p.sum())
    R, t, w, f = _vote(
        scene.points,
        scene.normals,
        scene.classes,
        scene.weights,
        references,
        partners.astype(np.int32),
        tables.cloud_points,
        tables.cloud_normals,
        tables.ppf_keys,
        tables.ppf,
        tables.ppf_alpha,
        tables.parameters["ppf_bin_m"],
        MIN_DISTANCE * diameter_m,
        1.05 * diameter_m,
    )
    return Votes(R, t, w, f)


@jit
def onto_x(x: float, y: float, z: float, R: Float64) -> None:
    """Write into R (3, 3) a rotation that takes the unit normal (x, y, z) onto the x axis."""
    if x < -0.999999:
        R[:] = 0.0
        R[0, 0], R[1, 1], R[2, 2] = -1.0, -1.0, 1.0
        return
    k = 1.0 / (1.0 + x)
    R[0, 0], R[0, 1], R[0, 2] = x, y, z
    R[1, 0], R[1, 1], R[1, 2] = -y, 1.0 - y * y * k, -y * z * k
    R[2, 0], R[2, 1], R[2, 2] = -z, -y * z * k, 1.0 - z * z * k


@jit
def _angle(a: Float, b: Float) -> float:
    c = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return float(np.arccos(min(max(c, -1.0), 1.0)))


@jit
def _feature(
    points: Float32, normals: Float32, i: int, j: int, R: Float64, d: Float64, out: Float64
) -> float:
    """Write distance and three angles of a pair into `out` (4,); return alpha. R (3, 3) and d (3,) are
    scratch."""
    for a in range(3):
        d[a] = points[j, a] - points[i, a]
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    onto_x(normals[i, 0], normals[i, 1], normals[i, 2], R)
    y = R[1, 0] * d[0] + R[1, 1] * d[1] + R[1, 2] * d[2]
    z = R[2, 0] * d[0] + R[2, 1] * d[1] + R[2, 2] * d[2]
    for a in range(3):
        d[a] /= max(length, 1e-12)
    out[0] = length
    out[1] = _angle(normals[i], d)
    out[2] = _angle(normals[j], d)
    out[3] = _angle(normals[i], normals[j])
    return float(np.arctan2(z, y))


@jit
def _features(
    points: Float32,
    normals: Float32,
    classes: UInt8,
    first: Int32,
    second: Int32,
    bin_m: float,
) -> tuple[Int64, Float32]:
    keys = np.empty(first.shape[0], np.int64)
    alpha = np.empty(first.shape[0], np.float32)
    R = np.empty((3, 3))
    d = np.empty(3)
    f = np.empty(4)
    for k in range(first.shape[0]):
        i, j = first[k], second[k]
        alpha[k] = _feature(points, normals, i, j, R, d, f)
        key = np.int64(classes[i]) * MAX_CLASSES + classes[j]
        key = key * MAX_BINS + min(int(f[0] / bin_m), MAX_BINS - 1)
        for a in range(1, 4):
            key = key * ANGLES + min(int(f[a] / np.pi * ANGLES), ANGLES - 1)
        keys[k] = key
    return keys, alpha


@jit
def _vote(
    points: Float32,
    normals: Float32,
    classes: UInt8,
    weights: Float32,
    references: Int32,
    partners: Int32,
    model_points: Float32,
    model_normals: Float32,
    keys: Int64,
    pairs: Int32,
    alpha: Float32,
    bin_m: float,
    min_distance: float,
    max_distance: float,
) -> tuple[Float32, Float32, Float32, Int32]:
    turns = 24
    votes = np.zeros((model_points.shape[0], turns), np.float32)
    touched = np.empty(1 << 18, np.int32)
    capacity = 8 * references.shape[0]
    out_R = np.empty((capacity, 3, 3), np.float32)
    out_t = np.empty((capacity, 3), np.float32)
    out_w = np.empty(capacity, np.float32)
    out_f = np.empty(capacity, np.int32)
    count = 0
    R = np.empty((3, 3))
    Rm = np.empty((3, 3))
    d = np.empty(3)
    f = np.empty(4)
    bins = np.empty(4, np.int64)
    other = np.empty(4, np.int64)
    for r in range(references.shape[0]):
        i = references[r]
        n_touched = 0
        for s in range(partners.shape[0]):
            j = partners[s]
            if i == j:
                continue
            turn = _feature(points, normals, i, j, R, d, f)
            if f[0] < min_distance or f[0] > max_distance:
                continue
            for a in range(4):
                x = f[0] / bin_m if a == 0 else f[a] / np.pi * ANGLES
                last = MAX_BINS - 1 if a == 0 else ANGLES - 1
                bins[a] = min(int(x), last)
                # the nearer neighbouring bin: a value near a border is looked up in both
                other[a] = min(max(bins[a] + (1 if x - int(x) > 0.5 else -1), 0), last)
            head = np.int64(classes[i]) * MAX_CLASSES + classes[j]
            for combination in range(16):
                key = head * MAX_BINS + (other[0] if combination & 1 else bins[0])
                repeated = bool(combination & 1) and other[0] == bins[0]
                for a in range(1, 4):
                    pick = (combination >> a) & 1
                    repeated = repeated or (pick == 1 and other[a] == bins[a])
                    key = key * ANGLES + (other[a] if pick else bins[a])
                if repeated:
                    continue
                k = np.searchsorted(keys, key)
                while k < keys.shape[0] and keys[k] == key:
                    m = pairs[k, 0]
                    a_bin = (turn - alpha[k]) / (2 * np.pi)
                    b = int((a_bin - np.floor(a_bin)) * turns) % turns
                    if votes[m, b] == 0.0 and n_touched < touched.shape[0]:
                        touched[n_touched] = m * turns + b
                        n_touched += 1
                    votes[m, b] += weights[j]
                    k += 1
        best = np.float32(0.0)
        for k in range(n_touched):
            best = max(best, votes[touched[k] // turns, touched[k] % turns])
        taken = 0
        for k in range(n_touched):
            m, b = touched[k] // turns, touched[k] % turns
            v = votes[m, b]
            if v >= PEAKS * best and best > 0 and taken < 8 and count < capacity:
                onto_x(normals[i, 0], normals[i, 1], normals[i, 2], R)
                onto_x(model_normals[m, 0], model_normals[m, 1], model_normals[m, 2], Rm)
                angle = (b + 0.5) / turns * 2 * np.pi
                c, s = np.cos(angle), np.sin(angle)
                for x in range(3):
                    # R^T Rx(angle) Rm
                    h0 = R[0, x]
                    h1 = R[1, x] * c + R[2, x] * s
                    h2 = -R[1, x] * s + R[2, x] * c
                    for y in range(3):
                        out_R[count, x, y] = h0 * Rm[0, y] + h1 * Rm[1, y] + h2 * Rm[2, y]
                for x in range(3):
                    moved = 0.0
                    for y in range(3):
                        moved += out_R[count, x, y] * model_points[m, y]
                    out_t[count, x] = points[i, x] - moved
                out_w[count] = v * weights[i]
                out_f[count] = r
                count += 1
                taken += 1
        for k in range(n_touched):
            votes[touched[k] // turns, touched[k] % turns] = 0.0
    return out_R[:count].copy(), out_t[:count].copy(), out_w[:count].copy(), out_f[:count].copy()
