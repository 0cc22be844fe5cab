"""Every frame with what was to be found, what was found and what was not there (`--plots`)."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from huepose.datasets.types import Sample
from huepose.drawing.overlay import draw_label
from huepose.evaluation.perception_rows import FrameFigures
from huepose.geometry.arrays import UInt8
from huepose.geometry.box import Box
from huepose.support.errors import InputError

FOUND, MISSED, FALSE = (60, 200, 80), (250, 200, 40), (235, 60, 50)


class PerceptionPictures:
    """Writes SCENE_IMAGE.png into a folder: found labels green, missed ones yellow, false boxes red."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, found=error.strerror or str(error), expected="a folder") from None

    def frame(self, sample: Sample, figures: FrameFigures) -> None:
        """Draw and write one frame."""
        picture = draw_perception(sample, figures)
        ok = cv2.imwrite(
            str(self._folder / f"{sample.scene}_{sample.image:06d}.png"),
            np.ascontiguousarray(picture[..., ::-1]),
        )
        if not ok:
            raise InputError(self._folder, found="a picture could not be written")


def draw_perception(sample: Sample, figures: FrameFigures) -> UInt8:
    """The frame (H, W, 3) uint8 RGB with boxes and names."""
    picture = sample.frame.color.copy()
    taken, false = figures.verdict(figures.asked)
    for row in figures.rows:
        pose = taken.get(row.instance)
        note = row.name if pose is None else f"{row.name} {pose.quality:.2f}"
        picture = _box(picture, row.box, note, MISSED if pose is None else FOUND)
    for wrong in false:
        picture = _box(picture, wrong.box, f"{wrong.name} {wrong.quality:.2f}", FALSE)
    return picture


def _box(picture: UInt8, box: Box, note: str, color: tuple[int, int, int]) -> UInt8:
    cv2.rectangle(picture, (round(box.x), round(box.y)), (round(box.x1) - 1, round(box.y1) - 1), color, 2)
    return draw_label(picture, note, (box.x, box.y), color, 0.4)
