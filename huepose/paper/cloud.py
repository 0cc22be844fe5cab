"""The classified cloud: both sides of every colour pair as surface points with a soft colour class.

The paper decouples pairs into their two colours, which give scene points a class and a weight (section
III-C). The same is done with the model's pairs, so both clouds have the same kind of points: each lies beside
the edge, on the side that has its colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Int, UInt8
from huepose.support.jit import jit

LIGHTNESS = 0.5
"""Weight of L against a and b when colours are compared with classes: light changes L most."""

ROUNDS = 25
"""Iterations of k-means."""

MAX_CLASSES, MAX_BINS = 16, 64
"""Numbers of classes, and of bins of a length, that a key of a triangle or of a point pair has room for."""


@dataclass(frozen=True, eq=False)
class ClassifiedCloud:
    """points, normals (M, 3) float32; classes (M,) uint8; weights (M,) float32 in 0..1."""

    points: Float32
    normals: Float32
    classes: UInt8
    weights: Float32

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, index: Int | Bool | slice) -> ClassifiedCloud:
        return ClassifiedCloud(
            self.points[index], self.normals[index], self.classes[index], self.weights[index]
        )


def color_classes(colors: Float32, count: int) -> Float32:
    """Prototypes (K, 3) of CIELAB colours (N, 3), K <= count: k-means, deterministic, darkest first.

    It starts from the colours farthest from those already chosen, so that rare but distinct colours get a
    class.
    """
    scale = np.array([LIGHTNESS, 1.0, 1.0], np.float32)
    x = np.asarray(colors, np.float32) * scale
    centers = [x.mean(0)]
    distance = np.full(len(x), np.inf, np.float32)
    for _ in range(count):
        distance = np.minimum(distance, ((x - centers[-1]) ** 2).sum(1))
        # the 98th percentile, not a single outlier
        k = np.argsort(distance)[int(0.98 * (len(x) - 1))]
        if distance[k] < 9.0:
            break
        centers.append(x[k])
    centers = centers[1:] or centers
    c = np.stack(centers)
    for _ in range(ROUNDS):
        nearest = nearest_class(x / scale, c / scale)
        c = np.stack([x[nearest == k].mean(0) if (nearest == k).any() else c[k] for k in range(len(c))])
    c = c / scale
    return np.asarray(c[np.argsort(c[:, 0], kind="stable")], np.float32)


def nearest_class(colors: Float, centers: Float) -> UInt8:
    """Index (...,) uint8 of the nearest prototype (K, 3) of each colour (..., 3)."""
    scale = np.array([LIGHTNESS, 1.0, 1.0])
    d = (((np.asarray(colors)[..., None, :] - centers) * scale) ** 2).sum(-1)
    return np.asarray(d.argmin(-1), np.uint8)


def decoupled(
    points: Float32, normals: Float32, tangents: Float32, classes: UInt8, weights: Float32, offset_m: float
) -> ClassifiedCloud:
    """Both sides of pairs as points: points, normals, tangents (N, 3), classes (N, 2), weights (N, 2)."""
    step = np.float32(offset_m) * tangents
    return ClassifiedCloud(
        np.concatenate([points - step, points + step]).astype(np.float32),
        np.concatenate([normals, normals]).astype(np.float32),
        np.concatenate([classes[:, 0], classes[:, 1]]).astype(np.uint8),
        np.concatenate([weights[:, 0], weights[:, 1]]).astype(np.float32),
    )


def sparse(cloud: ClassifiedCloud, spacing_m: float) -> Int:
    """Rows (S,), heaviest first: no two points of one class with similar normals are nearer than the
    spacing."""
    order = np.argsort(-cloud.weights, kind="stable")
    if not len(order):
        return order
    return order[_thin(cloud.points[order], cloud.normals[order], cloud.classes[order], spacing_m)]


@jit
def _thin(points: Float32, normals: Float32, classes: UInt8, spacing: float) -> Bool:
    n = points.shape[0]
    low = np.empty(3)
    size = np.empty(3, np.int64)
    for a in range(3):
        low[a] = points[:, a].min()
        size[a] = int((points[:, a].max() - low[a]) / spacing) + 1
    head = np.full((size[0], size[1], size[2]), -1, np.int32)
    follow = np.full(n, -1, np.int32)
    kept = np.zeros(n, np.bool_)
    cell = np.empty(3, np.int64)
    for i in range(n):
        for a in range(3):
            cell[a] = int((points[i, a] - low[a]) / spacing)
        free = True
        for x in range(max(cell[0] - 1, 0), min(cell[0] + 2, size[0])):
            for y in range(max(cell[1] - 1, 0), min(cell[1] + 2, size[1])):
                for z in range(max(cell[2] - 1, 0), min(cell[2] + 2, size[2])):
                    j = head[x, y, z]
                    while j >= 0 and free:
                        if classes[i] == classes[j]:
                            d = 0.0
                            facing = 0.0
                            for a in range(3):
                                d += (points[i, a] - points[j, a]) ** 2
                                facing += normals[i, a] * normals[j, a]
                            if d < spacing * spacing and facing > 0.5:
                                free = False
                        j = follow[j]
        if free:
            kept[i] = True
            follow[i] = head[cell[0], cell[1], cell[2]]
            head[cell[0], cell[1], cell[2]] = i
    return kept
