"""How much speaks for another texture: the share of seen contrasts at the model's pairs that point elsewhere.

A correlation of colours says that something disagrees, not how much of the surface does: a third of the
texture in strong other hues pulls it down as far as a look-alike does, which has another texture all over. So
pairs are counted. The contrast of a pair is a direction in colour; light, shadow and exposure change its
length, noise turns what is short, and only another colour turns what is long. Where the same object's texture
is partly out of date, the contrasts of the rest still point their way; of a look-alike hardly any do.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float, Float64
from huepose.judge.arrays import RegionArrays, region_arrays
from huepose.judge.pair_kernel import PairArrays, PairPicture, read_pair
from huepose.judge.pair_terms import pair_arrays
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit

LIGHTNESS = 0.2
"""Of lightness against the other two channels: light and dark agree by chance more often than hues do, and
shading is lightness, too."""

ASIDE = 0.75
"""Tangent of the angle within which two contrasts point the same way: what coloured light turns them by."""

NOISE = 3.0
"""Units of opponents by which a contrast may be off for no reason; one as long as this counts half, on the
texture and in the picture."""

NEUTRAL = 3.0
"""So many clear contrasts are taken to agree beforehand: without texture nothing speaks against it."""


def contrast_disagreement_many(
    model: ReferenceModel, region: Region, picture: PairPicture, poses: Float, pairs: int = 1500
) -> Float64:
    """Share (M,), 0..1, of the contrasts that point elsewhere, at poses (M, 4, 4), by at most `pairs` of the
    model's pairs; 0 where none is seen."""
    out = np.zeros(len(poses))
    for m, T in enumerate(poses):
        voices, elsewhere = contrasts(model, region, picture, T, pairs)
        out[m] = voices[elsewhere].sum() / (NEUTRAL + voices.sum())
    return out


def contrasts(
    model: ReferenceModel, region: Region, picture: PairPicture, T_cam_obj: Float, pairs: int = 1500
) -> tuple[Float64, Bool]:
    """Of the pairs of `pair_arrays` at a pose (4, 4): how clear the contrast of each is (N,), 0..1, 0 where
    it is not seen; and whether it points elsewhere (N,)."""
    arrays = pair_arrays(model.pairs, pairs)
    count = len(arrays.points)
    voices, strengths, elsewhere = np.zeros(count), np.zeros(count), np.zeros(count, np.bool_)
    _compare(
        np.ascontiguousarray(T_cam_obj, dtype=np.float64),
        region_arrays(region),
        arrays,
        picture,
        voices,
        strengths,
        elsewhere,
    )
    seen = voices > 0.0
    if seen.any():
        # None speaks louder than the usual one.
        voices *= np.minimum(strengths / np.median(strengths[seen]), 1.0)
    return voices, elsewhere


@jit
def _compare(
    T: Float64,
    region: RegionArrays,
    pairs: PairArrays,
    picture: PairPicture,
    voices: Float64,
    strengths: Float64,
    elsewhere: Bool,
) -> None:
    """Of each pair that is seen, how clear its contrast is on the texture and in the picture, how strong it
    is on the texture, and whether the picture's points elsewhere."""
    read = np.empty((2, 3))
    for i in range(pairs.points.shape[0]):
        facing = read_pair(T, i, region, pairs, picture, read)
        if facing == 0.0:
            continue
        mm, ss, dot = 1e-12, 0.0, 0.0
        for c in range(3):
            w = LIGHTNESS if c == 0 else 1.0
            a = w * (pairs.colors[i, 1, c] - pairs.colors[i, 0, c])
            b = w * (read[1, c] - read[0, c])
            mm += a * a
            ss += b * b
            dot += a * b
        of_texture, seen = np.sqrt(mm), np.sqrt(ss)
        along = dot / of_texture
        across = np.sqrt(max(ss - along * along, 0.0))
        voices[i] = facing * of_texture / (of_texture + NOISE) * seen / (seen + NOISE)
        strengths[i] = of_texture
        elsewhere[i] = across > ASIDE * along + NOISE
