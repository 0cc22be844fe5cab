"""How far figures of few frames may be trusted: intervals by drawing frames again, with replacement.

Frames and not instances are drawn, because the objects of one frame share its light and its noise (Efron and
Tibshirani 1993, the bootstrap over clusters).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence

import numpy as np

from huepose.geometry.arrays import Float

Interval = tuple[float, float]


def frame_intervals(
    values: Mapping[str, Float],
    frames: Sequence[Hashable],
    share: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> dict[str, Interval]:
    """For each figure the central interval of its mean that holds `share` of the resamples.

    values: one number an instance (N,), by figure; frames: which frame each instance is of (N,).

    >>> frame_intervals({"recall": np.array([100.0, 100.0, 100.0])}, [1, 1, 2])
    {'recall': (100.0, 100.0)}
    """
    if not len(frames):
        return {}
    number = {frame: k for k, frame in enumerate(dict.fromkeys(frames))}
    index = np.array([number[frame] for frame in frames])
    rng = np.random.default_rng(seed)
    times = rng.multinomial(len(number), np.full(len(number), 1.0 / len(number)), resamples)
    counts = times @ np.bincount(index, minlength=len(number))
    tails = [50.0 * (1.0 - share), 50.0 * (1.0 + share)]
    result = {}
    for name, each in values.items():
        sums = times @ np.bincount(index, weights=np.asarray(each, np.float64), minlength=len(number))
        low, high = np.percentile(sums / counts, tails)
        result[name] = (float(low), float(high))
    return result
