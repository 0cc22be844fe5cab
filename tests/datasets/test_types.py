"""When a label counts as visible and as gone."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth


@pytest.mark.parametrize(
    ("fraction", "visible", "gone"),
    [
        (None, True, False),
        (1.0, True, False),
        (0.3, True, False),
        (0.29, False, False),
        (0.1, False, False),
        (0.09, False, True),
    ],
)
def test_visible_and_gone_depend_on_the_visible_fraction(
    fraction: float | None, visible: bool, gone: bool
) -> None:
    truth = GroundTruth(0, np.eye(4), visib_fract=fraction)
    assert (truth.visible, truth.gone) == (visible, gone)
