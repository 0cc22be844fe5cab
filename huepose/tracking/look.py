"""What the judge says of poses in an open region: closely of one, quickly of many."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.judge.open_region import OpenRegion
from huepose.judge.surface import PreparedSurface
from huepose.judge.terms import Terms, score_arrays

SAMPLES = 400
"""Surface samples of a close look."""


def look(surface: PreparedSurface, region: OpenRegion, T_cam_obj: Float64) -> Terms:
    """Look at a pose (4, 4) closely."""
    terms = score_arrays(surface.arrays, region.arrays, np.asarray(T_cam_obj)[None], SAMPLES)[0]
    return Terms(*(float(x) for x in terms))


def totals(
    surface: PreparedSurface,
    region: OpenRegion,
    poses: Float64,
    samples: int,
    tolerance_m: float | None = None,
) -> Float64:
    """Totals (K,) of poses (K, 4, 4) by few samples and the coarser colours, whose basins are wide."""
    arrays = region.blunt()
    if tolerance_m is not None:
        arrays = arrays._replace(tolerance=tolerance_m)
    return np.asarray(score_arrays(surface.arrays, arrays, poses, samples)[:, 0])
