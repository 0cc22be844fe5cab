"""Averages of samples within a radius. Samples are sorted into cells; no neighbour lists are stored."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from huepose.geometry.arrays import Float, Float64, Int64
from huepose.support.jit import jit


class Cells(NamedTuple):
    """Samples sorted by cubic cells of side `size`; keys (M,): the cell of each."""

    points: Float64
    normals: Float64
    values: Float64
    keys: Int64
    low: Float64
    size: float
    shape: Int64

    @staticmethod
    def of(points: Float, normals: Float, values: Float, radius: float) -> Cells:
        """Sort samples (M, 3) with normals (M, 3) and values (M, C) for searches within `radius`."""
        p = np.asarray(points, np.float64)
        low = p.min(0) - radius
        cell = ((p - low) / radius).astype(np.int64)
        shape = cell.max(0) + 2
        keys = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
        order = np.argsort(keys, kind="stable")
        return Cells(
            p[order],
            np.asarray(normals, np.float64)[order],
            np.asarray(values, np.float64)[order],
            keys[order],
            low,
            radius,
            shape,
        )

    def gaussian(self, points: Float, normals: Float, sigma: float) -> tuple[Float64, Float64]:
        """Weighted means (N, C) of the values around oriented points (N, 3), and total weights (N,). A
        weight is a Gaussian of the distance, within the radius, times the cosine to the sample's normal, at
        least 0."""
        out = np.zeros((len(points), self.values.shape[1]))
        weights = np.zeros(len(points))
        _gaussian(self, _columns(points), _columns(normals), sigma, out, weights)
        return out, weights

    def facing_sum(self, points: Float, normals: Float, least_cosine: float) -> Float64:
        """Sums (N, 3) of the normals within the radius whose cosine to `normals` (N, 3) is at least
        `least_cosine`."""
        out = np.zeros((len(points), 3))
        _facing_sum(self, _columns(points), _columns(normals), least_cosine, out)
        return out


def _columns(a: Float) -> Float64:
    return np.ascontiguousarray(a, np.float64)


@jit
def _row(cells: Cells, i: int, j: int, k: int) -> tuple[int, int]:
    """Range [first, last) of the samples in the cells (i, j, k - 1 .. k + 1), which are contiguous."""
    keys, shape = cells.keys, cells.shape
    if i < 0 or j < 0 or i >= shape[0] or j >= shape[1]:
        return 0, 0
    base = (i * shape[1] + j) * shape[2]
    low, high = max(k - 1, 0), min(k + 1, shape[2] - 1)
    if high < low:
        return 0, 0
    return np.searchsorted(keys, base + low), np.searchsorted(keys, base + high, side="right")


@jit
def _cell(cells: Cells, at: Float64) -> tuple[int, int, int]:
    """The cell (i, j, k) that contains a point (3,)."""
    low, size = cells.low, cells.size
    return (
        int(np.floor((at[0] - low[0]) / size)),
        int(np.floor((at[1] - low[1]) / size)),
        int(np.floor((at[2] - low[2]) / size)),
    )


@jit
def _square_and_cosine(point: Float64, normal: Float64, at: Float64, facing: Float64) -> tuple[float, float]:
    """Squared distance between two oriented points, and the cosine between their normals."""
    d0, d1, d2 = point[0] - at[0], point[1] - at[1], point[2] - at[2]
    cosine = normal[0] * facing[0] + normal[1] * facing[1] + normal[2] * facing[2]
    return d0 * d0 + d1 * d1 + d2 * d2, cosine


@jit
def _gaussian(
    cells: Cells, at: Float64, facing: Float64, sigma: float, out: Float64, weights: Float64
) -> None:
    points, normals, values, size = cells.points, cells.normals, cells.values, cells.size
    for q in range(at.shape[0]):
        c0, c1, c2 = _cell(cells, at[q])
        for i in range(c0 - 1, c0 + 2):
            for j in range(c1 - 1, c1 + 2):
                first, last = _row(cells, i, j, c2)
                for m in range(first, last):
                    square, cosine = _square_and_cosine(points[m], normals[m], at[q], facing[q])
                    if square > size * size or cosine <= 0.0:
                        continue
                    w = np.exp(-square / (2.0 * sigma * sigma)) * cosine
                    weights[q] += w
                    for k in range(values.shape[1]):
                        out[q, k] += w * values[m, k]
        if weights[q] > 0.0:
            for k in range(values.shape[1]):
                out[q, k] /= weights[q]


@jit
def _facing_sum(cells: Cells, at: Float64, facing: Float64, least: float, out: Float64) -> None:
    points, normals, size = cells.points, cells.normals, cells.size
    for q in range(at.shape[0]):
        c0, c1, c2 = _cell(cells, at[q])
        for i in range(c0 - 1, c0 + 2):
            for j in range(c1 - 1, c1 + 2):
                first, last = _row(cells, i, j, c2)
                for m in range(first, last):
                    square, cosine = _square_and_cosine(points[m], normals[m], at[q], facing[q])
                    if square <= size * size and cosine > least:
                        for k in range(3):
                            out[q, k] += normals[m, k]
