"""What a pose explains of a frame: the evidence behind every published pose, and a score to compare starts
by.

Unlike the dense score of `verification`, which judges hypotheses inside a mask, this one needs no mask: a
tracker knows where the object should be, and asks what is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64, UInt8
from huepose.support.jit import jit
from huepose.tracking.refinement import depth_noise_m
from huepose.tracking.region import STEPS, Region, RegionArrays
from huepose.tracking.samples import FAR_ALONG_RAY, MIN_COSINE, decoded, nearest_view, placed
from huepose.tracking.surface import SurfaceArrays, TrackedSurface

FIT_WEIGHT, BEHIND_WEIGHT, COLOR_WEIGHT, HIDDEN_WEIGHT = 0.7, 0.5, 1.3, 0.1
LIGHTNESS_SHARE = 0.4
"""Weight of lightness against hue: shading changes it, but fine print is often black on white."""

TEXTURELESS = 4.0
"""Lab units of contrast that count as none. Their share of the colour term is left to the mean colour."""

CONTRAST_FLOOR = 3.0
NO_DEPTH_WEIGHT = 0.3
L_ORIGIN = 16.0
"""A gain in linear light scales L + 16, a and b by one factor."""

TINT_SIGMA = (14.0, 7.0, 7.0)
"""Lab units by which the mean colour of a known object in known light may be off: shading, mostly."""

TERMS = 12

Tint = tuple[float, float, float]


@dataclass(frozen=True)
class Fit:
    """What a pose explains; shares are of the visible surface, weighted by how squarely it is seen.

    total: the score, about 0 for nonsense, 1 to 1.9 for a right pose; depth_fit 0..1: agreement of the depth
    that speaks; behind: seen through (free space violated); hidden: something is in front; seen: agrees in
    depth; outside: out of the image; no_depth; color -1..1: correlation of image and texture, light taken
    out, and where there is little texture the agreement of the mean colour, if the light is known;
    residual_m: rms distance of agreeing depth along the normals; texture: Lab units of contrast in view;
    tint: what the light does to the mean colour: factor of (L + 16, a, b), then shifts of a and b; a factor
    of 0 where nothing was seen.
    """

    total: float
    depth_fit: float
    behind: float
    color: float
    hidden: float
    seen: float
    residual_m: float
    outside: float
    no_depth: float
    texture: float
    tint: Tint


UNKNOWN_TINT = (0.0, 0.0, 0.0)

NOTHING = Fit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, UNKNOWN_TINT)
"""Of a pose outside of the image."""


def tolerance_m(diameter_m: float, distance_m: float) -> float:
    """How far a reading may lie from the surface and yet support it."""
    return max(0.006, min(0.012, 0.05 * diameter_m)) + 2.0 * (depth_noise_m(distance_m) - 0.0005)


def score(
    surface: TrackedSurface,
    region: Region,
    T_cam_obj: Float,
    level: int = 1,
    samples: int = 400,
    tint: Tint = UNKNOWN_TINT,
) -> Fit:
    """Judge one pose with at most that many samples at a texture level, in a light whose tint may be known
    (some 20 us)."""
    out = np.zeros(TERMS)
    T = np.ascontiguousarray(T_cam_obj, np.float64)
    tau = tolerance_m(surface.diameter_m, float(surface.centre_cam(T)[2]))
    total = _score(T, surface.arrays, region.arrays, level, samples, tau, tint, out)
    f = [float(x) for x in out]
    return Fit(total, f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], (f[9], f[10], f[11]))


def score_all(
    surface: TrackedSurface,
    region: Region,
    poses: Float,
    level: int,
    samples: int,
    tolerance: float,
    tint: Tint = UNKNOWN_TINT,
) -> Float64:
    """Totals (K,) of poses (K, 4, 4), with a given depth tolerance in metres."""
    totals = np.zeros(len(poses))
    _score_all(
        np.ascontiguousarray(poses, np.float64),
        surface.arrays,
        region.arrays,
        level,
        samples,
        tolerance,
        tint,
        totals,
    )
    return totals


@jit
def _score_all(
    poses: Float64,
    surface: SurfaceArrays,
    region: RegionArrays,
    level: int,
    limit: int,
    tau: float,
    tint: Tint,
    totals: Float64,
) -> None:
    out = np.empty(TERMS)
    for k in range(poses.shape[0]):
        totals[k] = _score(poses[k], surface, region, level, limit, tau, tint, out)


@jit
def _score(
    T: Float64,
    surface: SurfaceArrays,
    region: RegionArrays,
    level: int,
    limit: int,
    tau: float,
    tint: Tint,
    out: Float64,
) -> float:
    """Total of a pose; the other fields of Fit go to `out` in order."""
    view = nearest_view(T, surface)
    first = surface.offsets[view]
    depth, reference = region.depth, surface.lab[level]
    height, width = depth.shape
    image = region.fine if level == 0 else (region.middle if level == 1 else region.coarse)
    step = STEPS[level]
    h, w = image.shape[0], image.shape[1]
    moments = np.zeros((3, 5))
    fit = agree = behind = hidden = outside = no_depth = square = colored = 0.0
    total = 1e-9
    for k in range(first, min(surface.offsets[view + 1], first + limit)):
        i = surface.visible[k]
        x, y, z, n0, n1, n2, c = placed(T, surface, i)
        if c < MIN_COSINE:
            continue
        total += c
        u, v = x / z * region.fx + region.cx, y / z * region.fy + region.cy
        column, row = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
        if column < 0 or row < 0 or column >= width or row >= height:
            outside += c
            continue
        seen = depth[row, column]
        g = c
        if seen <= 0.0:
            no_depth += c
            g *= NO_DEPTH_WEIGHT
        else:
            e = n0 * ((column - region.cx) / region.fx * seen - x)
            e += n1 * ((row - region.cy) / region.fy * seen - y) + n2 * (seen - z)
            if abs(e) < tau and abs(seen - z) < FAR_ALONG_RAY * tau:
                fit += c * (1.0 - (e / tau) ** 2)
                square += c * e * e
                agree += c
            elif seen > z:
                behind += c
                continue
            else:
                hidden += c
                continue
        if region.usable[row, column] == 0:
            continue
        px, py = (u + 0.5) / step - 0.5, (v + 0.5) / step - 0.5
        x0, y0 = int(np.floor(px)), int(np.floor(py))
        if x0 < 0 or y0 < 0 or x0 >= w - 1 or y0 >= h - 1:
            continue
        colored += g
        _add_moments(moments, g, reference, i, image, y0, x0, px - x0, py - y0)
    out[9] = out[10] = out[11] = 0.0
    color = contrast = 0.0
    if colored > 0.02 * total:
        color, contrast = _color_agreement(moments, colored, tint, out)
    expected = agree + behind + 0.15 * total
    out[0], out[1], out[2], out[3] = fit / expected, behind / expected, color, hidden / total
    out[4] = agree / total
    out[5] = np.sqrt(square / agree) if agree > 0.0 else 0.0
    out[6], out[7], out[8] = outside / total, no_depth / total, contrast
    return float(FIT_WEIGHT * out[0] - BEHIND_WEIGHT * out[1] + COLOR_WEIGHT * color - HIDDEN_WEIGHT * out[3])


@jit
def _add_moments(
    moments: Float64, g: float, reference: Float64, i: int, image: UInt8, y0: int, x0: int, a: float, b: float
) -> None:
    """Add one sample's texture and bilinear image colour to the moments (3, 5) of their joint
    distribution."""
    for q in range(3):
        p = (decoded(image, y0, x0, q) * (1 - a) + decoded(image, y0, x0 + 1, q) * a) * (1 - b)
        p += (decoded(image, y0 + 1, x0, q) * (1 - a) + decoded(image, y0 + 1, x0 + 1, q) * a) * b
        r = reference[i, q]
        moments[q, 0] += g * r
        moments[q, 1] += g * p
        moments[q, 2] += g * r * r
        moments[q, 3] += g * p * p
        moments[q, 4] += g * r * p


@jit
def _color_agreement(moments: Float64, colored: float, tint: Tint, out: Float64) -> tuple[float, float]:
    """Correlation over the channels, each by its contrast in the texture, filled up by the agreement of the
    mean colour; and that contrast in Lab units. The tint of the samples goes to out[9:12]."""
    color = weight = 0.0
    for q in range(3):
        mx, my = moments[q, 0] / colored, moments[q, 1] / colored
        vx = max(moments[q, 2] / colored - mx * mx, 0.0)
        vy = max(moments[q, 3] / colored - my * my, 0.0)
        s = np.sqrt(vx) * (LIGHTNESS_SHARE if q == 0 else 1.0)
        color += s * (moments[q, 4] / colored - mx * my) / (np.sqrt(vx * vy) + CONTRAST_FLOOR)
        weight += s
    texture_l, image_l = moments[0, 0] / colored, moments[0, 1] / colored
    factor = (image_l + L_ORIGIN) / (texture_l + L_ORIGIN)
    out[9] = factor
    for q in range(1, 3):
        out[9 + q] = (moments[q, 1] - factor * moments[q, 0]) / colored
    mean = 0.0
    if tint[0] > 0.0:
        d = ((tint[0] - factor) * (texture_l + L_ORIGIN) / TINT_SIGMA[0]) ** 2
        for q in range(1, 3):
            expected = tint[0] * moments[q, 0] / colored + tint[q]
            d += ((moments[q, 1] / colored - expected) / TINT_SIGMA[q]) ** 2
        mean = np.exp(-0.5 * d)
    return (color + TEXTURELESS * mean) / (weight + TEXTURELESS), weight
