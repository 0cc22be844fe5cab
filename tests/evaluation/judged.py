"""Judged poses with made-up evidence."""

import numpy as np

from huepose.believe.quality import QualityTerms
from huepose.evaluation.calibration import Judged

PLAIN = QualityTerms(
    1.5, (0.1, 0.3), 0.4, 0.8, 0.7, 0.7, 0.1, 0.1, 0.7, 0.2, 10.0, 0.4, 0.0, 2000.0, 0.0, 0.1, 1.0
)


def judged(terms: list[QualityTerms], which: np.ndarray, per_frame: int = 5) -> Judged:
    """Judged poses in the form of the evaluation; which: the index of the right candidate, -1 for none."""
    n = len(terms)
    return Judged(
        terms,
        which.astype(np.int64),
        which == 0,
        [k // per_frame for k in range(n)],
        range(n),
        np.full(n, 0.5),
        np.ones(n),
    )
