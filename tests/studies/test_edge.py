"""An object is seen through a window, and what is outside of it is known."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Camera, RgbdFrame, se3
from studies.edge import Row, outside, report
from studies.stress.films import Seen


@pytest.mark.parametrize(("x_m", "share"), [(0.0, 0.0), (0.35, 0.5), (0.6, 1.0)])
def test_what_lies_beyond_the_picture_is_outside(tea_box, x_m: float, share: float) -> None:
    camera = Camera(400.0, 400.0, 199.5, 149.5, 400, 300)
    frame = RgbdFrame(np.zeros((300, 400, 3), np.uint8), np.ones((300, 400), np.float32), camera)
    T = se3.make(np.eye(3), np.array([x_m, 0.0, 0.7]) - tea_box.mesh.centre)
    assert outside(tea_box, Seen(frame, T, 1.0)) == pytest.approx(share, abs=0.05)


def test_the_report_counts_poses() -> None:
    done = [Row(11, "mug", 100, 2, 30, 1), Row(11, "can", 50, 0, 10, 0)]
    assert report(done) == (
        "TRACKING: 150 right, 2 wrong; of these 40 right, 1 wrong with more than half outside of the picture"
    )
