"""Where sizes do not fit: is it the camera, or one object?

A wrong camera matrix or unit of depth shows all objects larger, or all smaller, by the same share. Where
others fit, an object that does not is not what its mesh says: the same product in another size, or a mesh
that is too large or too small. Of an object alone nobody can tell; then the camera is doubted, and its
sentence names the mesh as well.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from huepose.estimation.apparent_size import CLEAR, SCALES, USUAL, ApparentSize, apparent_size, looks
from huepose.estimation.types import PoseEstimate
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel

K = TypeVar("K", bound=Hashable)

INDEPENDENT = 3
"""Looks at one object count as so many at most: of a thing that stands still they repeat each other."""

OUTNUMBERED = 3
"""So many objects must clearly speak against the camera for each that clearly has its usual size."""

LIKELY = 0.2
"""Least quality of a pose that is asked though it is not sure: where nothing is, the background is often
taken for an object of another size. As `ReinitConfig.least_quality`."""

AGAINST = 3.0
"""What all objects but the loudest may have against its share together, as a natural logarithm, before the
camera is not doubted for it: odds of 20."""

ALIKE = 0.02
"""By such a share scanned models differ in what they say of one camera."""

_IS_USUAL = np.abs(SCALES) <= USUAL
_USUAL = SCALES[_IS_USUAL]


def doubted_camera(seen: Mapping[K, Sequence[Float64]], fewest: int = 1) -> ApparentSize | None:
    """The size that objects have in common where it speaks against the camera. seen: by name or instance, the
    `support` (S,) of each look at an object; fewest: so many, of all objects, are asked for."""
    every = [one for mine in seen.values() for one in mine]
    together = apparent_size(every)
    if not together.clear or len(every) < fewest:
        return None
    totals = _totals(seen)
    against = {key: _against(total, together.larger) for key, total in totals.items()}
    fit = sum(gain >= CLEAR for gain in against.values())
    if OUTNUMBERED * fit > sum(gain <= -CLEAR for gain in against.values()):
        return None
    quieter = sorted(against, key=lambda key: against[key])[1:]
    total = np.sum([totals[key] for key in quieter] or [np.zeros(len(SCALES))], axis=0)
    return together if _against(total, together.larger) <= AGAINST else None


def doubted_objects(seen: Mapping[K, Sequence[Float64]], fewest: int = 1) -> dict[K, ApparentSize]:
    """The size of each object that clearly differs from what is usual and from what the others have in
    common, where the camera is not doubted. seen: as there; fewest: so many looks at an object are asked
    for."""
    totals = _totals(seen)
    out: dict[K, ApparentSize] = {}
    usual = {key: _USUAL[np.argmax(total[_IS_USUAL])] for key, total in totals.items()}
    for key, total in totals.items():
        # The median, since one of the others may be of another size itself.
        others = [size for name, size in usual.items() if name != key]
        if others and len(seen[key]) >= fewest:
            size = apparent_size([total], float(np.median(others)))
            out |= {key: size} if size.clear else {}
    return out


def doubted_in(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], answers: Sequence[PoseEstimate]
) -> tuple[ApparentSize | None, dict[int, ApparentSize]]:
    """What one frame says against its camera; if nothing, against objects, by their place in its answers."""
    sure = [k for k, answer in enumerate(answers) if answer.state == "TRACKING"]
    likely = [k for k, answer in enumerate(answers) if answer.found and answer.quality >= LIKELY]
    seen = {k: looks(frame, models, [answers[k]]) for k in sorted({*sure, *likely})}
    # Of those that are not sure the camera is asked where none is.
    camera = doubted_camera({k: seen[k] for k in sure or likely})
    return camera, {} if camera else doubted_objects(seen)


def said(size: ApparentSize) -> str:
    """Of an object whose size is doubted."""
    way, mesh = ("larger", "small") if size.larger > 0 else ("smaller", "large")
    return (
        f"The picture shows it about {100 * abs(size.larger):.0f} % {way} than its mesh, while other objects "
        f"fit: it is the same thing in another size, or the mesh is too {mesh}."
    )


def _totals(seen: Mapping[K, Sequence[Float64]]) -> dict[K, Float64]:
    return {k: np.mean(mine, 0) * min(len(mine), INDEPENDENT) for k, mine in seen.items() if len(mine)}


def _against(total: Float64, larger: float) -> float:
    """By how much the support (S,) is greater for a usual size, or one that differs the other way, than for
    that share."""
    near, other = np.abs(SCALES - larger) <= ALIKE + 1e-9, np.sign(larger) * SCALES <= USUAL
    return float(total[other].max() - total[near].max())
