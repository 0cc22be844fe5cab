"""Semantic triangles: three points of three different classes determine a pose (paper, section III-C).

Offline, triangles that are large and whose centroid lies far from the object's centre are hashed under a
seven-dimensional key that no rigid motion changes: three class ids in ascending order (which also orders the
corners), three quantised sides, and the chirality, which is the sign of the triangle's normal against the
mean normal of the surface at its corners: it distinguishes a triangle from its mirror image. Online, scene
triangles are looked up in their bins and the neighbouring ones. Of many entries under one key a few are taken
at equal steps through the list, which is ordered by the distance between centroid and object centre. Each
match gives a pose by Kabsch's fit of three points.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float32, Float64, Int32, Int64, UInt8
from huepose.model.types import PaperTables
from huepose.paper.cloud import MAX_BINS, MAX_CLASSES, ClassifiedCloud
from huepose.paper.votes import Votes
from huepose.support.jit import jit

BIN = 0.035
"""Width of a bin of the sides, in diameters."""

MIN_HEIGHT = 3.0
"""Smallest height of a triangle, in bins."""

ECCENTRICITY = 0.05
"""Weight of the distance of a triangle's centroid from the object's centre; the weight of its area is 1."""

CANDIDATES, ROWS = 600_000, 15_000
"""Triangles that are sampled offline, and how many of them are kept at most."""

SCENE_TRIANGLES = 1800
"""Largest number of triangles of a scene."""

PER_KEY = 3
"""Largest number of entries taken from one key."""

TOLERANCE = 1.0
"""Largest difference of matched sides, in bins."""

ANY_FACING = -1.0
"""`facing` of `triangle_votes` with which matched normals need not agree, as in the paper."""


def build_triangles(cloud: ClassifiedCloud, diameter_m: float) -> tuple[Int64, Int32]:
    """Keys (T,) int64, sorted, and corners (T, 3) int32 into the cloud in class order; under one key the
    entries are in order of the distance between centroid and object centre."""
    rng = np.random.default_rng(0)
    corners = draw_triples(cloud, CANDIDATES, rng)
    p = cloud.points[corners].astype(np.float64)
    n = cloud.normals[corners].astype(np.float64)
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    sides = np.stack([np.linalg.norm(p[:, (k + 1) % 3] - p[:, k], axis=1) for k in range(3)], 1)
    mean = n.sum(1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-9)
    bin_m = BIN * diameter_m
    height = 2 * area / np.maximum(sides.max(1), 1e-12)
    together = ((n * mean[:, None]).sum(2) > 0.25).all(1)  # one camera can see all three corners
    usable = together & (height > MIN_HEIGHT * bin_m) & (sides.max(1) < (MAX_BINS - 2) * bin_m)
    centre = 0.5 * (cloud.points.min(0) + cloud.points.max(0)) if len(cloud) else np.zeros(3)
    distance = np.linalg.norm(p.mean(1) - centre, axis=1)
    quality = area / diameter_m**2 + ECCENTRICITY * distance / diameter_m
    rows = np.flatnonzero(usable)
    rows = rows[np.argsort(-quality[rows], kind="stable")][:ROWS]
    chirality = (normal[rows] * mean[rows]).sum(1) > 0
    classes = cloud.classes[corners[rows]].astype(np.int64)
    keys = pack(classes, np.floor(sides[rows] / bin_m).astype(np.int64), chirality)
    order = np.lexsort((distance[rows], keys))
    return keys[order], corners[rows][order].astype(np.int32)


def draw_triples(cloud: ClassifiedCloud, count: int, rng: np.random.Generator) -> Int32:
    """At most `count` triples (T, 3) int32 of points of three different classes, corners in class order.

    Points are sampled by weight, those of rare classes more often.
    """
    if len(cloud) < 3:
        return np.zeros((0, 3), np.int32)
    sizes = np.bincount(cloud.classes, minlength=MAX_CLASSES)
    p = np.maximum(cloud.weights, 1e-6) / np.sqrt(sizes[cloud.classes])
    triples = rng.choice(len(cloud), (count, 3), p=p / p.sum()).astype(np.int32)
    classes = cloud.classes[triples]
    order = np.argsort(classes, axis=1, kind="stable")
    triples, classes = np.take_along_axis(triples, order, 1), np.take_along_axis(classes, order, 1)
    return triples[(classes[:, 0] < classes[:, 1]) & (classes[:, 1] < classes[:, 2])]


def pack(classes: Int64, bins: Int64, chirality: np.ndarray) -> Int64:
    """Keys (T,) of classes (T, 3) ascending, side bins (T, 3), chirality (T,) bool."""
    c = (classes[:, 0] * MAX_CLASSES + classes[:, 1]) * MAX_CLASSES + classes[:, 2]
    q = (bins[:, 0] * MAX_BINS + bins[:, 1]) * MAX_BINS + bins[:, 2]
    return np.asarray((c * MAX_BINS**3 + q) * 2 + chirality, np.int64)


def triangle_votes(
    scene: ClassifiedCloud, tables: PaperTables, facing: float, rng: np.random.Generator
) -> Votes:
    """Poses from matches between triangles of the scene's classified cloud (camera axes) and those of a
    model; facing: smallest mean cosine between matched normals."""
    if not len(tables.triangle_keys) or len(scene) < 3:
        return Votes.empty()
    # about two in three samples have three different classes and a useful shape
    triples = draw_triples(scene, 3 * SCENE_TRIANGLES, rng)
    R, t, w, f = _look_up(
        scene.points,
        scene.normals,
        scene.classes,
        scene.weights,
        triples,
        tables.cloud_points,
        tables.cloud_normals,
        tables.triangle_keys,
        tables.triangles,
        tables.parameters["triangle_bin_m"],
        facing,
    )
    return Votes(R, t, w, f)


@jit
def _fit(p: Float64, q: Float64, R: Float64, t: Float64) -> None:
    """Kabsch's rotation and translation from triangle p (3, 3 by rows) to q, in closed form: both are planar,
    so the best rotation aligns the planes and then rotates within the plane."""
    pc = np.zeros(3)
    qc = np.zeros(3)
    for a in range(3):
        for k in range(3):
            pc[a] += p[k, a] / 3.0
            qc[a] += q[k, a] / 3.0
    frames = np.empty((2, 3, 3))
    for which in range(2):
        x = p if which == 0 else q
        e0, e1, e2 = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1], x[1, 2] - x[0, 2]
        g0, g1, g2 = x[2, 0] - x[0, 0], x[2, 1] - x[0, 1], x[2, 2] - x[0, 2]
        n0, n1, n2 = e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        n0, n1, n2 = n0 / length, n1 / length, n2 / length
        length = np.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        e0, e1, e2 = e0 / length, e1 / length, e2 / length
        f = frames[which]
        f[0, 0], f[0, 1], f[0, 2] = e0, e1, e2
        f[1, 0], f[1, 1], f[1, 2] = n1 * e2 - n2 * e1, n2 * e0 - n0 * e2, n0 * e1 - n1 * e0
        f[2, 0], f[2, 1], f[2, 2] = n0, n1, n2
    dot = 0.0
    cross = 0.0
    for k in range(3):
        px, py, qx, qy = 0.0, 0.0, 0.0, 0.0
        for a in range(3):
            px += frames[0, 0, a] * (p[k, a] - pc[a])
            py += frames[0, 1, a] * (p[k, a] - pc[a])
            qx += frames[1, 0, a] * (q[k, a] - qc[a])
            qy += frames[1, 1, a] * (q[k, a] - qc[a])
        dot += px * qx + py * qy
        cross += px * qy - py * qx
    length = np.sqrt(dot * dot + cross * cross)
    c, s = dot / length, cross / length
    for i in range(3):
        x1 = c * frames[1, 0, i] + s * frames[1, 1, i]
        x2 = c * frames[1, 1, i] - s * frames[1, 0, i]
        for j in range(3):
            R[i, j] = x1 * frames[0, 0, j] + x2 * frames[0, 1, j] + frames[1, 2, i] * frames[0, 2, j]
    for i in range(3):
        t[i] = qc[i] - (R[i, 0] * pc[0] + R[i, 1] * pc[1] + R[i, 2] * pc[2])


@jit
def _look_up(
    points: Float32,
    normals: Float32,
    classes: UInt8,
    weights: Float32,
    triples: Int32,
    model_points: Float32,
    model_normals: Float32,
    keys: Int64,
    triangles: Int32,
    bin_m: float,
    facing: float,
) -> tuple[Float32, Float32, Float32, Int32]:
    capacity = 1 << 16
    out_R = np.empty((capacity, 3, 3), np.float32)
    out_t = np.empty((capacity, 3), np.float32)
    out_w = np.empty(capacity, np.float32)
    out_f = np.empty(capacity, np.int32)
    count = 0
    used = 0
    p = np.empty((3, 3))
    q = np.empty((3, 3))
    R = np.empty((3, 3))
    t = np.empty(3)
    side = np.empty(3)
    mean = np.empty(3)
    shift = np.empty(3, np.int64)
    for i in range(triples.shape[0]):
        if used >= SCENE_TRIANGLES or count > capacity - 27 * PER_KEY:
            break
        weight = 1.0
        for k in range(3):
            weight *= weights[triples[i, k]]
            for a in range(3):
                q[k, a] = points[triples[i, k], a]
        longest = 0.0
        for k in range(3):
            m = (k + 1) % 3
            side[k] = np.sqrt((q[k, 0] - q[m, 0]) ** 2 + (q[k, 1] - q[m, 1]) ** 2 + (q[k, 2] - q[m, 2]) ** 2)
            longest = max(longest, side[k])
        if longest >= (MAX_BINS - 2) * bin_m or longest < 1e-9:
            continue
        e0, e1, e2 = q[1, 0] - q[0, 0], q[1, 1] - q[0, 1], q[1, 2] - q[0, 2]
        g0, g1, g2 = q[2, 0] - q[0, 0], q[2, 1] - q[0, 1], q[2, 2] - q[0, 2]
        n0, n1, n2 = e1 * g2 - e2 * g1, e2 * g0 - e0 * g2, e0 * g1 - e1 * g0
        if np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) / longest < MIN_HEIGHT * bin_m:
            continue
        for a in range(3):
            mean[a] = normals[triples[i, 0], a] + normals[triples[i, 1], a] + normals[triples[i, 2], a]
        chirality = 1 if n0 * mean[0] + n1 * mean[1] + n2 * mean[2] > 0 else 0
        head = np.int64(classes[triples[i, 0]])
        head = (head * MAX_CLASSES + classes[triples[i, 1]]) * MAX_CLASSES + classes[triples[i, 2]]
        first = count
        used += 1
        for combination in range(27):
            shift[0] = combination // 9 - 1
            shift[1] = (combination // 3) % 3 - 1
            shift[2] = combination % 3 - 1
            key = head
            inside = True
            for k in range(3):
                b = int(side[k] / bin_m) + shift[k]
                if b < 0 or b >= MAX_BINS:
                    inside = False
                key = key * MAX_BINS + b
            if not inside:
                continue
            key = key * 2 + chirality
            low = np.searchsorted(keys, key)
            high = low
            while high < keys.shape[0] and keys[high] == key:
                high += 1
            entries = high - low
            taken = min(entries, PER_KEY)
            for e in range(taken):
                # equal steps through the list, which is ordered by the distance from the object's centre
                row = low + int((e + 0.5) * entries / taken)
                sides_match = True
                for k in range(3):
                    for a in range(3):
                        p[k, a] = model_points[triangles[row, k], a]
                for k in range(3):
                    m = (k + 1) % 3
                    s = np.sqrt(
                        (p[k, 0] - p[m, 0]) ** 2 + (p[k, 1] - p[m, 1]) ** 2 + (p[k, 2] - p[m, 2]) ** 2
                    )
                    if abs(s - side[k]) > TOLERANCE * bin_m:
                        sides_match = False
                if not sides_match:
                    continue
                _fit(p, q, R, t)
                agreement = 0.0
                for k in range(3):
                    for a in range(3):
                        rotated = 0.0
                        for b in range(3):
                            rotated += R[a, b] * model_normals[triangles[row, k], b]
                        agreement += rotated * normals[triples[i, k], a] / 3.0
                if agreement < facing:
                    continue
                out_R[count] = R
                out_t[count] = t
                out_w[count] = weight
                out_f[count] = used - 1
                count += 1
        for j in range(first, count):
            out_w[j] /= np.sqrt(count - first)
    return out_R[:count].copy(), out_t[:count].copy(), out_w[:count].copy(), out_f[:count].copy()
