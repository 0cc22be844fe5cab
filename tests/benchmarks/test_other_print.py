"""The benchmark of changed prints: what is counted grows with what was changed, in drawn light."""

import sys
from pathlib import Path

import numpy as np

from huepose.model.types import ReferenceModel

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from other_print import lines, measured


def test_contrasts_elsewhere_grow_with_the_share_that_was_changed(tea_box: ReferenceModel) -> None:
    seen = {share: np.array(measured(tea_box, "recoloured", share, 3, 0)) for share in (0.0, 0.1, 1.0)}
    few, some, most = (float(np.median(rows[:, 0])) for rows in seen.values())
    assert few < 0.3
    assert few <= some < most - 0.2
    text = lines({("recoloured", share): rows for share, rows in seen.items()})
    assert "1.000" in text  # all as it is are lower than all that are changed all over
