"""The chart of stages: a row for each thing that has any, and none for what is one number."""

from __future__ import annotations

from pathlib import Path

import cv2

from huepose_services.cli.bench import draw_stages


def test_what_has_stages_gets_a_row(tmp_path: Path) -> None:
    tracking = [("track", 9.0, 20.0), ("track/follow", 8.0, 19.0), ("segment", 3.0, 4.0)]
    finding = [("detect", 50.0, 60.0), ("detect/look", 8.0, 9.0), ("detect two", 26.0, 40.0)]
    draw_stages(tmp_path / "a.png", [*tracking, *finding])
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture is not None
    assert picture.shape[0] == 2 * 320
    draw_stages(tmp_path / "b.png", [("segment", 3.0, 4.0)])
    assert not (tmp_path / "b.png").exists()
