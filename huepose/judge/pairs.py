"""Judge a pose by colour pairs: do the model's pairs find their two colours where the pose projects them?

The model's pairs that are visible at the pose are projected, and the picture is read on both sides of each
edge, as opponents. Light is fitted at the pose itself, as the offset and gain per channel that fit all read
colours best; so the first term is a correlation of colours. The second term is a correlation of the
differences between the two sides, in which light and slow shading cancel. Depth, free space and coverage of
the mask are judged by the dense score (`judge.terms`) with its colour term switched off.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from huepose.colorpair.lifting import MIN_FACING
from huepose.colorpair.opponents import opponents_of_bytes, opponents_of_lab
from huepose.geometry.arrays import Float, Float32, Float64
from huepose.geometry.camera import NEAREST_M
from huepose.judge.color_correlation import PLAIN
from huepose.judge.kernel import SCRATCH_ROWS, TERMS, score_kernel
from huepose.judge.region import Crop, ModelArrays, Region, RegionArrays, model_arrays, region_arrays
from huepose.judge.terms import DEFAULT_WEIGHTS, ScoreWeights
from huepose.model.types import PairReference, ReferenceModel
from huepose.support.jit import jit
from huepose.support.kept import once_for_each

PAIR_TERMS = 5
"""Of a pose: total, geometry, color, contrast, and how many pairs are visible."""

GEOMETRY = DEFAULT_WEIGHTS._replace(color=0.0, box=0.2)
"""Weights of the dense score without colour, chosen for pairs."""


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

CLOSE_PAIRS, CLOSE_PAIR_SAMPLES = 1500, 600
"""Most colour pairs and surface samples with which the last few poses are judged."""

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


class PairPicture(NamedTuple):
    """A crop's colours at the scale at which pairs are compared: colors (h, w, 3) float32 opponents; su,
    sv: pixels of the crop for one of these, so that (u, v) of the crop is ((u + 0.5) / su - 0.5, ...)
    here."""

    colors: Float32
    su: float
    sv: float


class Judged(NamedTuple):
    """All inputs of the pair kernel. samples: most surface samples that are used; geometry, weights: of the
    dense score's terms and of the pair terms."""

    model: ModelArrays
    region: RegionArrays
    samples: int
    geometry: ScoreWeights
    pairs: PairArrays
    picture: PairPicture
    weights: PairWeights


class PairScratch(NamedTuple):
    """Scratch arrays of the pair kernel; out (5,): the terms of the last pose."""

    moments: Float64
    rows: Float64
    terms: Float64
    out: Float64


def scratch(samples: int) -> PairScratch:
    """Allocate the scratch arrays for at most `samples` surface samples."""
    return PairScratch(
        np.empty((6, 5)), np.empty((SCRATCH_ROWS, samples)), np.empty(TERMS), np.empty(PAIR_TERMS)
    )


@jit
def pair_kernel(T: Float64, on: Judged, work: PairScratch, needed: float) -> float:
    """Judge one pose T (4, 4). Returns the total and writes the terms to `work.out`.

    If the total cannot exceed `needed`, the kernel may stop early. It then returns an upper bound of the
    total that is not over `needed`, and `work.out` is undefined.
    """
    moments, out, weights = work.moments, work.out, on.weights
    moments[:] = 0.0
    visible = _read_pairs(T, on.region, on.pairs, on.picture, moments)
    few = visible / (visible + weights.few)
    color = few * _correlation(moments, 0, weights)
    contrast = few * _correlation(moments, 3, weights)
    colors = weights.color * color + weights.contrast * contrast
    # What geometry has to give; the slack is more than rounding.
    enough = needed - colors - 1e-9
    geometry = score_kernel(T, on.model, on.region, on.samples, on.geometry, work.rows, work.terms, enough)
    out[0] = geometry + colors
    out[1] = geometry
    out[2] = color
    out[3] = contrast
    out[4] = visible
    return float(out[0])


@jit
def read_pair(
    T: Float64, i: int, region: RegionArrays, pairs: PairArrays, picture: PairPicture, read: Float64
) -> float:
    """Read the picture on both sides of pair `i` into `read` (2, 3). Returns the cosine between surface
    normal and line of sight, 0 if the pair is not visible."""
    points, normals, tangents = pairs.points, pairs.normals, pairs.tangents
    depth, shown = region.depth, picture.colors
    height, width = depth.shape
    rows, columns = shown.shape[0], shown.shape[1]
    r00, r01, r02, r10, r11, r12 = T[0, 0], T[0, 1], T[0, 2], T[1, 0], T[1, 1], T[1, 2]
    r20, r21, r22, t0, t1, t2 = T[2, 0], T[2, 1], T[2, 2], T[0, 3], T[1, 3], T[2, 3]
    p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
    n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
    x = r00 * p0 + r01 * p1 + r02 * p2 + t0
    y = r10 * p0 + r11 * p1 + r12 * p2 + t1
    z = r20 * p0 + r21 * p1 + r22 * p2 + t2
    if z < NEAREST_M:
        return 0.0
    away = (
        (r00 * n0 + r01 * n1 + r02 * n2) * x
        + (r10 * n0 + r11 * n1 + r12 * n2) * y
        + (r20 * n0 + r21 * n1 + r22 * n2) * z
    )
    facing = -away / np.sqrt(x * x + y * y + z * z)
    if facing < MIN_FACING:
        return 0.0
    uf, vf = x / z * region.fx + region.cx, y / z * region.fy + region.cy
    if uf < 0.0 or vf < 0.0 or uf > width - 1.0 or vf > height - 1.0:
        return 0.0
    observed = depth[int(vf + 0.5), int(uf + 0.5)]
    if observed <= 0.0 or abs(observed - z) * facing > region.tolerance:
        return 0.0
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
            return 0.0
        if region.saturated[int(vf + 0.5), int(uf + 0.5)]:
            return 0.0
        uf = (uf + 0.5) / picture.su - 0.5
        vf = (vf + 0.5) / picture.sv - 0.5
        u, v = min(max(int(uf), 0), columns - 2), min(max(int(vf), 0), rows - 2)
        a, b = min(max(uf - u, 0.0), 1.0), min(max(vf - v, 0.0), 1.0)
        c00, c01, c10, c11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
        for c in range(3):
            read[side, c] = (
                c00 * shown[v, u, c]
                + c01 * shown[v, u + 1, c]
                + c10 * shown[v + 1, u, c]
                + c11 * shown[v + 1, u + 1, c]
            )
    return float(facing)


@jit
def _read_pairs(
    T: Float64, region: RegionArrays, pairs: PairArrays, picture: PairPicture, moments: Float64
) -> int:
    """Sums over the visible pairs into `moments` (6, 5): rows 0..2 of both sides' channels (weight, model,
    image and so on as below), rows 3..5 of the differences between the sides. Returns how many were
    visible."""
    colors, read = pairs.colors, np.empty((2, 3))
    visible = 0
    for i in range(pairs.points.shape[0]):
        facing = read_pair(T, i, region, pairs, picture, read)
        if facing == 0.0:
            continue
        visible += 1
        for c in range(3):
            for side in range(2):
                m, s = colors[i, side, c], read[side, c]
                moments[c, 0] += facing * m
                moments[c, 1] += facing * s
                moments[c, 2] += facing * m * m
                moments[c, 3] += facing * s * s
                moments[c, 4] += facing * m * s
            m, s = colors[i, 1, c] - colors[i, 0, c], read[1, c] - read[0, c]
            moments[3 + c, 0] += facing  # the sum of weights: differences have no mean to take off
            moments[3 + c, 2] += facing * m * m
            moments[3 + c, 3] += facing * s * s
            moments[3 + c, 4] += facing * m * s
    return visible


@jit
def _correlation(moments: Float64, first: int, weights: PairWeights) -> float:
    """Correlation over the three channels from row `first` on, each weighted by the variation of the model in
    it."""
    count = moments[3, 0]
    if count <= 0.0:
        return 0.0
    readings = 2.0 * count if first == 0 else count
    total, total_weight = 0.0, weights.even
    for c in range(3):
        q = first + c
        mean_m, mean_s = 0.0, 0.0
        if first == 0:
            mean_m, mean_s = moments[q, 0] / readings, moments[q, 1] / readings
        var_m = max(moments[q, 2] / readings - mean_m * mean_m, 0.0)
        var_s = max(moments[q, 3] / readings - mean_s * mean_s, 0.0)
        covariance = moments[q, 4] / readings - mean_m * mean_s
        w = (weights.lightness if c == 0 else 1.0) * np.sqrt(var_m)
        total += w * covariance / (np.sqrt(var_m * var_s) + weights.floor)
        total_weight += w
    return float(total / total_weight)


def pair_picture(model: ReferenceModel, crop: Crop, depth_m: float) -> PairPicture:
    """The crop's colours at the scale of the model's fine reference views, for an object at `depth_m`."""
    h, w = crop.depth.shape
    color = crop.color
    scale = model.pairs.parameters["fine_pixels_per_m"] * depth_m / crop.camera.fx
    if scale < 1.0:
        size = (max(round(w * scale), 2), max(round(h * scale), 2))
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return PairPicture(opponents_of_bytes(color), w / color.shape[1], h / color.shape[0])


def pair_score_many(
    model: ReferenceModel,
    region: Region,
    picture: PairPicture,
    poses: Float,
    pairs: int,
    samples: int,
) -> Float64:
    """Judge poses (M, 4, 4) by at most `pairs` of the model's pairs and `samples` of its surface.

    Returns (M, 5): total, comparable between poses on the same pixels; geometry, the dense score without
    colour; color and contrast, correlations in -1..1, lowered where there is little evidence; number of pairs
    compared.
    """
    out = np.zeros((len(poses), PAIR_TERMS))
    on = judged_on(model, region, picture, pairs, samples)
    _score_all(np.ascontiguousarray(poses, dtype=np.float64), on, scratch(samples), out)
    return out


def judged_on(
    model: ReferenceModel,
    region: Region,
    picture: PairPicture,
    pairs: int,
    samples: int,
) -> Judged:
    """Bundle at most `pairs` of the model's pairs, its surface and the picture for the kernel."""
    return Judged(
        model_arrays(model),
        region_arrays(region),
        samples,
        GEOMETRY,
        pair_arrays(model.pairs, pairs),
        picture,
        PAIR_WEIGHTS,
    )


def pair_arrays(reference: PairReference, count: int) -> PairArrays:
    """At most `count` of a model's fine pairs, evenly spread."""
    first = int(reference.parameters["coarse_pairs"])
    step = max(1, -(-(len(reference.points) - first) // count))
    rows = slice(first, None, step)
    return PairArrays(
        np.ascontiguousarray(reference.points[rows]),
        np.ascontiguousarray(reference.normals[rows]),
        np.ascontiguousarray(reference.tangents[rows]),
        np.ascontiguousarray(_fine_opponents(reference)[::step]),  # of one type, however many there are
        REACH_PX / reference.parameters["fine_pixels_per_m"],
    )


@once_for_each
def _fine_opponents(reference: PairReference) -> Float32:
    """Colours (N, 2, 3) of the fine pairs as opponents, made once for each model."""
    return opponents_of_lab(reference.colors[int(reference.parameters["coarse_pairs"]) :])


@jit
def _score_all(poses: Float64, on: Judged, work: PairScratch, out: Float64) -> None:
    for i in range(poses.shape[0]):
        pair_kernel(poses[i], on, work, -np.inf)
        out[i] = work.out
