"""Does the image show this object's texture, or a look-alike's? Evidence that the dense score cannot give.

`texture_evidence`: a look-alike (same shape, other texture) has a lower colour correlation than the object
itself, but not lower than an object with little texture. So the function measures what is missing: how much
higher the agreement of the two chromatic opponents would be if the image showed this texture. With little
texture, that is little. It also measures how well details are seen, because sharp details separate poses that
blurred ones do not.

Correlations are dominated by the largest disagreement: a third of a surface in other, stronger colours
outweighs the rest. So colour pairs are counted as well, each with a bounded vote. `contrast_disagreement`:
share of visible contrasts that point elsewhere. The contrast of a pair is a vector in opponent space. Light,
shadow and exposure change its length; noise rotates short vectors, and only another colour rotates long ones.
`agreement_many`: how much of the texture agrees, where a part of it may be outdated or occluded: by contrasts
(where light cancels), and by colours under the light on which most of them agree. A pair that disagrees
counts as zero, not as negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float64
from huepose.geometry.bilinear import bilinear
from huepose.judge.color_correlation import PLAIN
from huepose.judge.kernel_arrays import RegionArrays, model_arrays, region_arrays, seen_samples
from huepose.judge.pairs import (
    CLOSE_PAIRS,
    PAIR_WEIGHTS,
    PairArrays,
    PairImage,
    pair_arrays,
    read_pairs,
    room_for,
)
from huepose.judge.region import Region
from huepose.judge.terms import CLOSE_SAMPLES
from huepose.judge.weights import DEFAULT_WEIGHTS
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

FEWEST_SAMPLES = 15
"""Least number of samples with fitting depth: with fewer there is no evidence."""

DETAIL_FLOOR = 0.75
"""Variance of detail (opponent units) that is noise."""

HUE_FLOOR = 40.0
"""Variance of hues (opponent units, both scales together) that is noise."""


@dataclass(frozen=True)
class TextureEvidence:
    """missing: agreement of the chromatic opponents that the image lacks, 0 (complete) to about 0.8.
    foreign: standard deviation of the image's opponents from the texture's, after one offset, opponent
    units.
    detail: correlation of structure below 3.5 mm, -1..1, low where the image does not show it.
    turned: rotation of the image's hues as a whole against the texture's, 0..1."""

    missing: float
    foreign: float
    detail: float
    turned: float


def texture_evidence(model: ReferenceModel, region: Region, T_cam_obj: Float) -> TextureEvidence:
    """The evidence at a pose T_cam_obj (4, 4); neutral (nothing missing, nothing foreign, no detail) if too
    little of the surface is visible."""
    seen = _seen_texture(model, region, np.ascontiguousarray(T_cam_obj, dtype=np.float64))
    if seen is None:
        return TextureEvidence(0.0, 0.0, 0.0, 0.0)
    weight, texture_colors, picture = seen
    share = weight / weight.sum()
    texture_colors = texture_colors - share @ texture_colors
    picture = picture - share @ picture
    of_texture, of_picture = share @ texture_colors**2, share @ picture**2
    both = share @ (texture_colors * picture)
    w = DEFAULT_WEIGHTS
    # Columns: lightness, red-green, yellow-blue at 1 mm, then at 3.5 mm.
    importance = np.sqrt(of_texture) * np.repeat([1.0, w.coarse], 3) * np.tile([w.lightness, 1.0, 1.0], 2)
    agreement = both / (np.sqrt(of_texture * of_picture) + w.color_floor)
    possible = of_texture / (of_texture + w.color_floor)
    chroma = [1, 2, 4, 5]
    missing = (importance * (possible - agreement))[chroma].sum() / (PLAIN + importance.sum())
    foreign = np.sqrt(max((of_texture + of_picture - 2.0 * both)[1:3].sum(), 0.0))
    turned = _turned(share, texture_colors[:, chroma], picture[:, chroma])
    return TextureEvidence(float(missing), float(foreign), _detail(share, texture_colors, picture), turned)


def _turned(share: Float64, texture_colors: Float64, picture: Float64) -> float:
    """Correlation of the image's hues with the texture's, rotated by a right angle, over both scales (N, 4).

    Light and exposure shift all hues alike and make them fainter; they do not rotate them."""
    across, strength = 0.0, HUE_FLOOR
    for k in (0, 2):
        p, q = texture_colors[:, k : k + 2], picture[:, k : k + 2]
        across += float(share @ (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]))
        strength += float(np.sqrt((share @ p**2).sum() * (share @ q**2).sum()))
    return abs(across) / strength


def _detail(share: Float64, texture_colors: Float64, picture: Float64) -> float:
    """Correlation of the differences between the two scales, over all three channels."""
    fine_texture = texture_colors[:, :3] - texture_colors[:, 3:]
    fine_picture = picture[:, :3] - picture[:, 3:]
    of_texture = float((share @ fine_texture**2).sum())
    of_picture = float((share @ fine_picture**2).sum())
    both = float((share @ (fine_texture * fine_picture)).sum())
    return both / float(np.sqrt(of_texture * of_picture) + DETAIL_FLOOR)


def _seen_texture(
    model: ReferenceModel, region: Region, T: Float64
) -> tuple[Float64, Float64, Float64] | None:
    """The visible samples whose depth fits: weights (N,), opponents of the texture (N, 6) and of the image
    (N, 6). None if there are too few."""
    m, r = model_arrays(model), region_arrays(region)
    seen = seen_samples(m, r, T, CLOSE_SAMPLES)
    if len(seen.which) < FEWEST_SAMPLES:
        return None
    outside = DEFAULT_WEIGHTS.outside
    weight = seen.facing * (outside + (1.0 - outside) * r.belief[seen.row, seen.column])
    texture_colors = np.concatenate([m.colors[0][seen.which], m.colors[1][seen.which]], axis=1)
    picture = np.concatenate([bilinear(colors, seen.u, seen.v) for colors in r.colors], axis=1)
    return weight, texture_colors.astype(np.float64), picture


CONTRAST_LIGHTNESS = 0.2
"""Weight of lightness against the other two channels: light and dark agree by chance more often than hues do,
and shading changes lightness, too."""

ASIDE = 0.75
"""Tangent of the angle within which two contrasts point the same way: coloured light rotates them by as
much."""

CONTRAST_NOISE = 3.0
"""Noise of a contrast, opponent units; one of this length counts half, in texture and image."""

NEUTRAL = 3.0
"""Prior: this many clear contrasts count as agreeing, so that without texture there is no evidence against
the pose."""


def contrast_disagreement(
    model: ReferenceModel, region: Region, picture: PairImage, T_cam_obj: Float
) -> float:
    """Share in 0..1 of visible contrasts that point elsewhere at a pose (4, 4); 0 where none is visible."""
    clarity, elsewhere = contrasts(model, region, picture, T_cam_obj, CLOSE_PAIRS)
    return float(clarity[elsewhere].sum() / (NEUTRAL + clarity.sum()))


def contrasts(
    model: ReferenceModel, region: Region, picture: PairImage, T_cam_obj: Float, pairs: int
) -> tuple[Float64, Bool]:
    """For each pair of `pair_arrays` at a pose (4, 4): clarity (N,) of its contrast, 0..1, 0 where not
    visible; and whether it points elsewhere (N,)."""
    arrays = pair_arrays(model.pairs, pairs)
    count = len(arrays.points)
    clarity, strengths, elsewhere = np.zeros(count), np.zeros(count), np.zeros(count, np.bool_)
    _compare_contrasts(
        np.ascontiguousarray(T_cam_obj, dtype=np.float64),
        region_arrays(region),
        arrays,
        picture,
        clarity,
        strengths,
        elsewhere,
    )
    seen = clarity > 0.0
    if seen.any():
        # No pair counts more than the median one.
        clarity *= np.minimum(strengths / np.median(strengths[seen]), 1.0)
    return clarity, elsewhere


@jit
def _compare_contrasts(
    T: Float64,
    region: RegionArrays,
    pairs: PairArrays,
    picture: PairImage,
    clarity: Float64,
    strengths: Float64,
    elsewhere: Bool,
) -> None:
    """For each visible pair: how clear its contrast is in texture and image, how strong it is in the texture,
    and whether the image's contrast points elsewhere."""
    found = room_for(pairs)
    for k in range(read_pairs(T, region, pairs, picture, found)):
        i, facing, read = found.which[k], found.facing[k], found.colors[k]
        mm, ss, dot = 1e-12, 0.0, 0.0
        for c in range(3):
            w = CONTRAST_LIGHTNESS if c == 0 else 1.0
            a = w * (pairs.colors[i, 1, c] - pairs.colors[i, 0, c])
            b = w * (read[1, c] - read[0, c])
            mm += a * a
            ss += b * b
            dot += a * b
        of_texture, seen = np.sqrt(mm), np.sqrt(ss)
        along = dot / of_texture
        across = np.sqrt(max(ss - along * along, 0.0))
        clarity[i] = facing * of_texture / (of_texture + CONTRAST_NOISE) * seen / (seen + CONTRAST_NOISE)
        strengths[i] = of_texture
        elsewhere[i] = across > ASIDE * along + CONTRAST_NOISE


PAIR_LIGHTNESS, PAIR_FLOOR, PAIR_FEW = PAIR_WEIGHTS.lightness, PAIR_WEIGHTS.floor, PAIR_WEIGHTS.few
"""The same values as in the score of pairs."""

HALF_AGREED = 16.0
"""Deviation from the common light, opponent units, at which a colour counts half."""

LIGHT_ROUNDS = 3
"""Rounds of reweighting to find the common light."""

FEWEST_PAIRS = 5
"""Least number of visible pairs: with fewer there is no evidence."""


def agreement_many(model: ReferenceModel, region: Region, picture: PairImage, poses: Float) -> Float64:
    """Sum of the agreeing shares of contrasts and of colours, 0..2 each pose: (M,) for poses (M, 4, 4)."""
    out = np.zeros(len(poses))
    _agree_all(
        np.ascontiguousarray(poses, dtype=np.float64),
        region_arrays(region),
        pair_arrays(model.pairs, CLOSE_PAIRS),
        picture,
        out,
    )
    return out


@jit
def _agree_all(
    poses: Float64, region: RegionArrays, pairs: PairArrays, picture: PairImage, out: Float64
) -> None:
    count = pairs.points.shape[0]
    found, model = room_for(pairs), np.empty((count, 2, 3))
    for m in range(poses.shape[0]):
        n = read_pairs(poses[m], region, pairs, picture, found)
        for k in range(n):
            model[k] = pairs.colors[found.which[k]]
        if n >= FEWEST_PAIRS:
            w, ours, theirs = found.facing[:n], model[:n], found.colors[:n]
            shares = _agreed_contrasts(w, ours, theirs) + _agreed_colors(w, ours, theirs)
            out[m] = n / (n + PAIR_FEW) * shares


@jit
def _agreed_contrasts(weights: Float64, model: Float64, seen: Float64) -> float:
    """Share of the texture's contrasts that the image shows. Each pair counts between 0 and its own contrast,
    and none counts more than the median one."""
    n = weights.shape[0]
    along, ours, theirs = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        dot, mm, ss = 0.0, 0.0, 0.0
        for c in range(3):
            w = PAIR_LIGHTNESS if c == 0 else 1.0
            a, b = w * (model[i, 1, c] - model[i, 0, c]), w * (seen[i, 1, c] - seen[i, 0, c])
            dot += a * b
            mm += a * a
            ss += b * b
        along[i], ours[i], theirs[i] = dot, np.sqrt(mm) + 1e-9, np.sqrt(ss) + 1e-9
    typical = np.median(ours)
    gain = min(max(np.median(theirs) / typical, 0.3), 3.0)
    total, agreed = 0.0, 0.0
    for i in range(n):
        longer, weight = max(ours[i], theirs[i] / gain), weights[i] * min(ours[i], typical)
        total += weight
        agreed += weight * max(along[i] / gain / (longer * longer), 0.0)
    return float(agreed / total)


@jit
def _agreed_colors(weights: Float64, model: Float64, seen: Float64) -> float:
    """Share of pair sides whose colour agrees under the offset and gain per channel on which most agree:
    reweighted least squares with squared Cauchy weights, from the median offset."""
    n = weights.shape[0]
    off, trust, total = np.zeros((n, 2)), np.empty((n, 2)), 2.0 * weights.sum()
    for c in range(3):
        apart = seen[:, :, c] - model[:, :, c]
        w = (PAIR_LIGHTNESS if c == 0 else 1.0) / (HALF_AGREED * HALF_AGREED)
        off += w * (apart - np.median(apart)) ** 2
    for _ in range(LIGHT_ROUNDS):
        for i in range(n):
            for side in range(2):
                trust[i, side] = weights[i] / (1.0 + off[i, side]) ** 2
        off[:] = 0.0
        for c in range(3):
            t, sm, ss, mm, ms = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                for side in range(2):
                    k, m, s = trust[i, side], model[i, side, c], seen[i, side, c]
                    t += k
                    sm += k * m
                    ss += k * s
                    mm += k * m * m
                    ms += k * m * s
            mean_m, mean_s = sm / t, ss / t
            spread = mm / t - mean_m * mean_m
            gain = (ms / t - mean_m * mean_s) / (spread + PAIR_FLOOR * PAIR_FLOOR)
            gain = min(max(gain, 0.2), 3.0)
            w = (PAIR_LIGHTNESS if c == 0 else 1.0) / (HALF_AGREED * HALF_AGREED)
            for i in range(n):
                for side in range(2):
                    e = (seen[i, side, c] - mean_s) / gain - (model[i, side, c] - mean_m)
                    off[i, side] += w * e * e
    agreed = 0.0
    for i in range(n):
        agreed += weights[i] / (1.0 + off[i, 0]) + weights[i] / (1.0 + off[i, 1])
    return float(agreed / total)
