"""Masks as run lengths: pixels row by row, the first run outside the mask (maybe of length 0), then in turn.

>>> runs_of(np.array([[True, False], [True, True]])).runs
[0, 1, 1, 2]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from huepose_protos.errors import WireError
from huepose_protos.messages import MaskRuns


def runs_of(mask: NDArray[np.bool_]) -> MaskRuns:
    """Run lengths of a mask (H, W)."""
    flat = np.ravel(mask).astype(np.int8)
    edges = np.flatnonzero(np.diff(flat, prepend=0, append=-1))
    runs = np.diff(edges, prepend=0)
    return MaskRuns(width=mask.shape[1], height=mask.shape[0], runs=runs.tolist())


def mask_of(mask: MaskRuns, image_size: tuple[int, int] | None = None) -> NDArray[np.bool_]:
    """Mask (H, W) of run lengths; MaskRuns has checked that they add up. image_size: height and width that it
    must have. Raises WireError for another size, before memory is taken."""
    if image_size not in (None, (mask.height, mask.width)):
        raise WireError(f"a mask of {mask.width} x {mask.height} pixels has not the size of its frame")
    inside = np.arange(len(mask.runs)) % 2 == 1
    return np.repeat(inside, mask.runs).reshape(mask.height, mask.width)
