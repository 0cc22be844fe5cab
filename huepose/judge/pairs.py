"""Read an image at colour pairs: the two colours at each pair of a model, where a pose projects it.

The model's pairs that are visible at the pose are projected, and the image is read on both sides of each
edge, as opponents.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from huepose.colorpair.lifting import MIN_FACING
from huepose.colorpair.opponents import opponents_of_bytes, opponents_of_lab
from huepose.geometry.arrays import Float32, Float64, Int64
from huepose.geometry.camera import NEAREST_M
from huepose.judge.color_correlation import PLAIN
from huepose.judge.kernel_arrays import RegionArrays, tolerance_at
from huepose.judge.region import Crop
from huepose.judge.weights import DEFAULT_WEIGHTS
from huepose.model.types import PairReference, ReferenceModel
from huepose.support.jit import jit
from huepose.support.kept import once_for_each


class PairWeights(NamedTuple):
    """Weights of the pair terms beside the geometry, as the kernels read them.

    color, contrast: of the two correlations.
    lightness: of lightness against the other two channels.
    floor: opponent units, keeps the correlation of plain surfaces low.
    even: added to the sum of the channels' weights, lowers objects without texture.
    few: number of visible pairs at which the colour terms count half.
    """

    color: float = 1.0
    contrast: float = 0.6
    lightness: float = 0.4
    floor: float = DEFAULT_WEIGHTS.color_floor
    even: float = PLAIN
    few: float = 10.0


PAIR_WEIGHTS = PairWeights()

CLOSE_PAIRS = 1500
"""Largest number of colour pairs with which the last few poses are judged."""

REACH_PX = 2.0
"""Distance from the edge at which the colours of a pair were sampled, pixels of the reference views: the
middle of the candidates of a sharp edge."""


class PairArrays(NamedTuple):
    """The model's pairs as the kernels read them: an even subset of the database."""

    points: Float32
    normals: Float32
    tangents: Float32
    colors: Float32
    reach: float


class PairImage(NamedTuple):
    """A crop's colours at the scale at which pairs are compared: colors (h, w, 3) float32 opponents; su, sv:
    pixels of the crop per pixel of `colors`, so that (u, v) of the crop is ((u + 0.5) / su - 0.5, ...)
    here."""

    colors: Float32
    su: float
    sv: float


class PairsRead(NamedTuple):
    """What an image shows of a model's pairs. which (N,): their indices; facing (N,): cosine between surface
    normal and line of sight; colors (N, 2, 3): opponents of both sides."""

    which: Int64
    facing: Float64
    colors: Float64


@jit
def room_for(pairs: PairArrays) -> PairsRead:
    """Arrays that `read_pairs` fills."""
    count = pairs.points.shape[0]
    return PairsRead(np.empty(count, np.int64), np.empty(count), np.empty((count, 2, 3)))


@jit
def read_pairs(
    T: Float64, region: RegionArrays, pairs: PairArrays, picture: PairImage, found: PairsRead
) -> int:
    """Read the image on both sides of all pairs that are visible at a pose (4, 4), into the first rows of
    `found`; returns their number. All pairs in one call: passing so many arrays for each pair costs more than
    reading it."""
    points, normals, tangents = pairs.points, pairs.normals, pairs.tangents
    depth, shown = region.depth, picture.colors
    height, width = depth.shape
    rows, columns = shown.shape[0], shown.shape[1]
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    n = 0
    for i in range(points.shape[0]):
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        x = r00 * p0 + r01 * p1 + r02 * p2 + t0
        y = r10 * p0 + r11 * p1 + r12 * p2 + t1
        z = r20 * p0 + r21 * p1 + r22 * p2 + t2
        if z < NEAREST_M:
            continue
        away = (
            (r00 * n0 + r01 * n1 + r02 * n2) * x
            + (r10 * n0 + r11 * n1 + r12 * n2) * y
            + (r20 * n0 + r21 * n1 + r22 * n2) * z
        )
        facing = -away / np.sqrt(x * x + y * y + z * z)
        if facing < MIN_FACING:
            continue
        uf, vf = x / z * region.fx + region.cx, y / z * region.fy + region.cy
        if uf < 0.0 or vf < 0.0 or uf > width - 1.0 or vf > height - 1.0:
            continue
        observed = depth[int(vf + 0.5), int(uf + 0.5)]
        if observed <= 0.0 or abs(observed - z) * facing > tolerance_at(region.tolerance, region.sigmas, z):
            continue
        q0, q1, q2 = tangents[i, 0] * pairs.reach, tangents[i, 1] * pairs.reach, tangents[i, 2] * pairs.reach
        s0 = r00 * q0 + r01 * q1 + r02 * q2
        s1 = r10 * q0 + r11 * q1 + r12 * q2
        s2 = r20 * q0 + r21 * q1 + r22 * q2
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            w = z + sign * s2
            uf = (x + sign * s0) / w * region.fx + region.cx
            vf = (y + sign * s1) / w * region.fy + region.cy
            if uf < 0.0 or vf < 0.0 or uf > width - 1.0 or vf > height - 1.0:
                break
            if region.saturated[int(vf + 0.5), int(uf + 0.5)]:
                break
            uf = (uf + 0.5) / picture.su - 0.5
            vf = (vf + 0.5) / picture.sv - 0.5
            u, v = min(max(int(uf), 0), columns - 2), min(max(int(vf), 0), rows - 2)
            a, b = min(max(uf - u, 0.0), 1.0), min(max(vf - v, 0.0), 1.0)
            c00, c01, c10, c11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            for c in range(3):
                found.colors[n, side, c] = (
                    c00 * shown[v, u, c]
                    + c01 * shown[v, u + 1, c]
                    + c10 * shown[v + 1, u, c]
                    + c11 * shown[v + 1, u + 1, c]
                )
        else:
            found.which[n], found.facing[n] = i, facing
            n += 1
    return n


def pair_image(model: ReferenceModel, crop: Crop, depth_m: float) -> PairImage:
    """The crop's colours at the scale of the model's fine reference views, for an object at `depth_m`."""
    h, w = crop.depth.shape
    color = crop.color
    scale = model.pairs.parameters["fine_pixels_per_m"] * depth_m / crop.camera.fx
    if scale < 1.0:
        size = (max(round(w * scale), 2), max(round(h * scale), 2))
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return PairImage(opponents_of_bytes(color), w / color.shape[1], h / color.shape[0])


def pair_arrays(reference: PairReference, count: int) -> PairArrays:
    """At most `count` of a model's fine pairs, evenly spread."""
    first = int(reference.parameters["coarse_pairs"])
    step = max(1, -(-(len(reference.points) - first) // count))
    rows = slice(first, None, step)
    return PairArrays(
        np.ascontiguousarray(reference.points[rows]),
        np.ascontiguousarray(reference.normals[rows]),
        np.ascontiguousarray(reference.tangents[rows]),
        np.ascontiguousarray(_fine_opponents(reference)[::step]),  # contiguous for any step: one type
        REACH_PX / reference.parameters["fine_pixels_per_m"],
    )


@once_for_each
def _fine_opponents(reference: PairReference) -> Float32:
    """Colours (N, 2, 3) of the fine pairs as opponents, made once for each model."""
    return opponents_of_lab(reference.colors[int(reference.parameters["coarse_pairs"]) :])
