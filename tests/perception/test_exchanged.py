"""An image with red and blue exchanged is distinguished from one without the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.exchanged import ChannelOrder, order_of_channels
from huepose.perception.types import Detection
from huepose.perception.view_detector import ViewDetector
from tests.conftest import TakePicture


def test_the_order_of_the_channels_is_determined(
    tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    detector = ViewDetector({"tea_box": tea_box})
    frame, empty = take_picture([(tea_box.mesh, standing)]), take_picture([])
    blue_first = replace(frame, color=np.ascontiguousarray(frame.color[:, :, ::-1]))
    said = order_of_channels(blue_first, detector, ["tea_box"])
    assert said.exchanged.startswith("With red and blue exchanged, tea_box is found in the image")
    assert not said.right
    assert order_of_channels(frame, detector, ["tea_box"]) == ChannelOrder(right=True)
    assert order_of_channels(frame, detector, ["tea_box"], {"tea_box": 0.9}) == ChannelOrder(right=True)
    assert order_of_channels(empty, detector, ["tea_box"]) == ChannelOrder()


class _Seen:
    """A detector of three objects: a grey one, one that is seen in the right order of channels, one that is
    absent."""

    def __init__(self, right: bool) -> None:
        self.right = right

    def detect(self, frame, names):
        as_it_is = bool(frame.color[0, 0, 0]) is self.right
        scores = {"grey": 0.95, "red": 0.9 if as_it_is else 0.4, "absent": 0.1}
        return [Detection(name, Box(0, 0, 9, 9), scores[name]) for name in names]


def test_an_object_that_looks_alike_in_both_orders_decides_nothing() -> None:
    color = np.zeros((8, 8, 3), np.uint8)
    color[:, :, 0] = 200
    frame = RgbdFrame(color, np.ones((8, 8), np.float32), Camera(8.0, 8.0, 3.5, 3.5, 8, 8))
    assert order_of_channels(frame, _Seen(True), ["grey", "absent"]) == ChannelOrder()
    assert order_of_channels(frame, _Seen(True), ["grey", "red", "absent"]).right
    said = order_of_channels(frame, _Seen(False), ["grey", "red", "absent"])
    assert said.exchanged.startswith("With red and blue exchanged, red is found in the image")
