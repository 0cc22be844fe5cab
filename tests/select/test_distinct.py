"""Poses keep the totals of the judge, in whatever order they are ranked."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.select.distinct import Ranked


def test_ranking_by_scores_keeps_the_totals() -> None:
    poses = np.arange(48, dtype=float).reshape(3, 4, 4)
    found = Ranked.of(poses, np.array([1.0, 3.0, 2.0]), np.array([0.5, 0.2, 0.9]))
    assert np.array_equal(found.poses, poses[[2, 0, 1]])
    assert found.totals.tolist() == [2.0, 1.0, 3.0]
    assert found.behind == pytest.approx([0.0, 0.4, 0.7])
    assert found.these([0, 2]).totals.tolist() == [2.0, 3.0]
