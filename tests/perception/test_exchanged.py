"""A picture with red and blue exchanged is told from one in which the object is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from huepose.geometry import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.exchanged import channels_exchanged


def test_the_order_of_the_channels_is_asked_for(
    tea_box: ReferenceModel, take_picture: Callable[..., RgbdFrame], standing: np.ndarray
) -> None:
    detector = ColorPairDetector({"tea_box": tea_box})
    frame, empty = take_picture([(tea_box.mesh, standing)]), take_picture([])
    blue_first = replace(frame, color=np.ascontiguousarray(frame.color[:, :, ::-1]))
    said = channels_exchanged(blue_first, detector, ["tea_box"])
    assert said is not None
    assert said.startswith("With red and blue exchanged, tea_box is in the picture")
    assert channels_exchanged(frame, detector, ["tea_box"]) is None
    assert channels_exchanged(empty, detector, ["tea_box"]) is None
