"""The film of an object that is taken away: the object, a cover, the background, the object again."""

from __future__ import annotations

import numpy as np

from huepose.datasets.types import GroundTruth
from huepose.geometry import Camera, RgbdFrame, se3
from studies.gone import PARTS_S, film
from studies.live import HZ

CAMERA = Camera(420.0, 420.0, 159.5, 119.5, 320, 240)


def test_the_object_is_visible_then_covered_then_gone_then_back(tea_box) -> None:
    color = np.full((240, 320, 3), 60, np.uint8)
    color[:, 120:200] = 200
    depth = np.full((240, 320), 0.9, np.float32)
    depth[:, 120:200] = 0.6
    label = GroundTruth(0, se3.make(np.eye(3), np.array([0.0, 0.0, 0.6])), 1, visib_fract=1.0)
    frames = film(RgbdFrame(color, depth, CAMERA), label, tea_box, np.random.default_rng(0))
    covered, gone, back, end = (HZ * seconds for seconds in PARTS_S)
    assert len(frames) == end
    middles = [seen.frame.color[115:125, 155:165].mean() for seen in frames]
    assert max(abs(m - 200.0) for m in middles[:covered]) < 2.0
    assert max(abs(m - 128.0) for m in middles[covered:gone]) < 2.0
    depths = [float(np.median(seen.frame.depth[115:125, 155:165])) for seen in frames]
    assert max(abs(z - 0.6) for z in depths[:covered]) < 0.002
    assert max(depths[covered:gone]) < 0.62
    assert max(abs(m - 200.0) for m in middles[back:]) < 2.0
    assert [seen.visib_fract > 0 for seen in frames] == [not covered <= k < back for k in range(end)]
    shown = {round(m, -1) for m in middles[gone:back]}
    assert shown <= {60.0, 200.0}
    assert len(shown) == 1, "the same background in all frames"
