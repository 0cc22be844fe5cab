"""The panels for a pose on the page that explains an answer."""

from __future__ import annotations

import numpy as np

from huepose.estimation.panels import AGREES, SEEN_THROUGH, Panels
from huepose.geometry import RgbdFrame, se3
from huepose.model.types import ReferenceModel
from tests.boxes import box_of


def test_pixels_that_agree_are_green_and_free_space_violations_red(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    box = box_of(box_frame, tea_box, standing)
    panels = Panels.around(box_frame, box, [], 0.008)
    right = panels.judged(tea_box, standing)
    nearer = se3.compose(se3.make(np.eye(3), [0.0, 0.0, -0.1]), standing)
    wrong = panels.judged(tea_box, nearer)
    share = {
        name: [float((np.abs(p.astype(int) - c).max(-1) < 30).mean()) for c in (AGREES, SEEN_THROUGH)]
        for name, p in (("right", right), ("wrong", wrong))
    }
    assert share["right"][0] > 0.3 > 0.02 > share["right"][1]
    assert share["wrong"][1] > 0.3 > 0.02 > share["wrong"][0]
