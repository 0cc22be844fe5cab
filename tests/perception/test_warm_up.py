"""Compiling a kernel at the first real search would take longer than a worker may be silent."""

from __future__ import annotations

from dataclasses import replace

from huepose.geometry import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import clear_view
from huepose.perception.config import DetectorConfig
from huepose.perception.view_detector import ViewDetector
from tests.kernels import compiled


def test_no_kernel_is_compiled_after_the_warm_up(tea_box: ReferenceModel, box_frame: RgbdFrame) -> None:
    detector = ViewDetector({"tea_box": tea_box}, DetectorConfig(remembering=True))
    detector.warm_up()
    before = compiled()
    view = clear_view(box_frame, tea_box.diameter_m)
    assert view is not None
    crop = view.crop
    x, y, camera = crop.x0, crop.y0, crop.camera
    depth = box_frame.depth[y : y + camera.height, x : x + camera.width].copy()
    filled = RgbdFrame(crop.color, depth, camera)  # its objects reach from side to side
    wired = replace(box_frame, color=box_frame.color.copy())
    wired.color.flags.writeable = False  # as in a message
    for frame in (box_frame, filled, wired):
        assert detector.detect(frame, ["tea_box"])
    assert compiled() == before
