"""How much speaks for another print: the share of seen contrasts at the model's pairs that point elsewhere.

A correlation of colours says that something disagrees, not how much of the surface does: a third of the
print in strong other hues pulls it down as far as a look-alike does, which has another print all over. So
pairs are counted. The contrast of a pair is a direction in colour; light, shadow and exposure change its
length, noise turns what is short, and only another colour turns what is long. Where the same object's print
is partly out of date, the contrasts of the rest still point their way; of a look-alike hardly any do.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.model.types import ReferenceModel
from huepose.support.jit import jit
from huepose.verification.kernel_arrays import RegionArrays, region_arrays
from huepose.verification.pairs import pair_arrays
from huepose.verification.pairs_kernel import PairArrays, PairPicture, read_pair
from huepose.verification.region import Region

LIGHTNESS = 0.2
"""Of lightness against the other two channels: light and dark agree by chance more often than hues do, and
shading is lightness, too."""

ASIDE = 0.75
"""Tangent of the angle within which two contrasts point the same way: what coloured light turns them by."""

NOISE = 3.0
"""Units of opponents by which a contrast may be off for no reason; one as long as this counts half, on the
print and in the picture."""

NEUTRAL = 3.0
"""So many clear contrasts are taken to agree beforehand: without print nothing speaks against it."""


def otherwise_many(
    model: ReferenceModel, region: Region, picture: PairPicture, poses: Float, pairs: int = 1500
) -> Float64:
    """Share (M,), 0..1, of the contrasts that point elsewhere, at poses (M, 4, 4), by at most `pairs` of the
    model's pairs; 0 where none is seen."""
    out = np.zeros(len(poses))
    _count_all(
        np.ascontiguousarray(poses, dtype=np.float64),
        region_arrays(region),
        pair_arrays(model.pairs, pairs),
        picture,
        out,
    )
    return out


@jit
def _count_all(
    poses: Float64, region: RegionArrays, pairs: PairArrays, picture: PairPicture, out: Float64
) -> None:
    count = pairs.points.shape[0]
    voices, ours, against = np.empty(count), np.empty(count), np.empty(count)
    read = np.empty((2, 3))
    for m in range(poses.shape[0]):
        n = 0
        for i in range(count):
            facing = read_pair(poses[m], i, region, pairs, picture, read)
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
            of_print, seen = np.sqrt(mm), np.sqrt(ss)
            along = dot / of_print
            across = np.sqrt(max(ss - along * along, 0.0))
            voices[n] = facing * of_print / (of_print + NOISE) * seen / (seen + NOISE)
            ours[n] = of_print
            against[n] = 1.0 if across > ASIDE * along + NOISE else 0.0
            n += 1
        if n == 0:
            continue
        usual = np.median(ours[:n])
        every, elsewhere = NEUTRAL, 0.0
        for i in range(n):
            voice = voices[i] * min(ours[i] / usual, 1.0)
            every += voice
            elsewhere += voice * against[i]
        out[m] = elsewhere / every
