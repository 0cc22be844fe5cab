"""Near-symmetric rotations of a pose, each judged in the light that it implies.

They show the same surface to the same lamps, and differ only in the texture. In the shade a texture has less
colour (`judge.implied_light`). So the right pose of a red brick can be far behind a rotation with dark holes
where the shade is.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Bool, Float64
from huepose.judge.implied_light import implied_lights, shading_gains
from huepose.judge.kernel_arrays import model_arrays, region_arrays
from huepose.judge.region import Region
from huepose.model.types import ReferenceModel
from huepose.select.distinct import Ranked

REACH = 0.4
"""In units of the total: rotations farther behind the first pose are not compared. A brick on a desk was 0.3
behind."""

CHANCE = 0.03
"""In units of the total: gains from light that differ by less are chance; larger differences count this much
less. Chosen by maximum likelihood of the right pose on rendered heaps and piles, `fit` and `choose`."""

ABOUT = np.radians(15.0)
"""Refinement rotates a pose by less than this: within it, two poses have the same orientation."""


def in_their_light(model: ReferenceModel, region: Region, found: Ranked) -> tuple[Ranked, bool]:
    """Poses reordered if light changes how far near-symmetric rotations of the first are behind it, and
    whether it does."""
    near = found.behind < REACH
    if np.count_nonzero(near) < 2:
        return found, False
    near[1:] &= rotated(model, found.poses[0], found.poses[1:])
    rivals = np.flatnonzero(near)
    if len(rivals) < 2:
        return found, False
    arrays, seen, poses = model_arrays(model), region_arrays(region), found.poses[rivals]
    gains = shading_gains(arrays, seen, poses, implied_lights(arrays, seen, poses))
    more = beyond_chance(gains - gains[0])
    if not more.any():
        return found, False
    scores = -found.behind
    scores[rivals] += more
    return Ranked.of(found.poses, found.totals, scores), True


def beyond_chance(more: Float64) -> Float64:
    """Differences (K,) between gains from light, less what is chance.

    >>> beyond_chance(np.array([0.02, 0.23, -0.05])).round(2).tolist()
    [0.0, 0.2, -0.02]
    """
    return np.asarray(np.sign(more) * np.maximum(np.abs(more) - CHANCE, 0.0))


def rotated(model: ReferenceModel, T_cam_obj: Float64, others: Float64) -> Bool:
    """Mask (K,) of the poses (K, 4, 4) that are near-symmetric rotations of another one (4, 4)."""
    between = T_cam_obj[:3, :3].T @ others[:, :3, :3]
    traces = np.einsum("kij,mij->km", between, model.near_symmetries[1:, :3, :3])
    return np.asarray((traces >= 1.0 + 2.0 * np.cos(ABOUT)).any(axis=1))
