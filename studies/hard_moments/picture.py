"""What became of every frame of the hard moments, as coloured bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from huepose.drawing.canvas import FONT, INK, Colour
from huepose.geometry.arrays import UInt8
from studies.hard_moments.play import Told

COLOURS: Mapping[str, Colour] = {
    "TRACKING, right": (70, 170, 90),
    "TRACKING, wrong": (220, 40, 40),
    "SUSPECT, right": (240, 205, 90),
    "SUSPECT, wrong": (235, 150, 50),
    "no pose": (120, 120, 130),
}
HIDDEN: Colour = (40, 60, 120)
LEFT_PX, WIDTH_PX, ROW_PX = 250, 760, 26


def meaning(told: Told) -> str:
    """Which band a frame belongs to."""
    if told.pose is None or told.pose.T_cam_obj is None or told.state is None:
        return "no pose"
    return f"{told.state}, {'right' if told.right else 'wrong'}"


def bands(rows: Sequence[tuple[str, Sequence[Told]]], title: str) -> UInt8:
    """A picture (H, W, 3): a row for each object of each moment, time to the right; the dark line under a
    band says how much of the object is hidden."""
    height = 70 + ROW_PX * len(rows)
    page: UInt8 = np.full((height, LEFT_PX + WIDTH_PX + 20, 3), 255, np.uint8)
    cv2.putText(page, title, (12, 24), FONT, 0.6, INK, 1, cv2.LINE_AA)
    x = 12
    for name, colour in {**COLOURS, "share hidden": HIDDEN}.items():
        cv2.rectangle(page, (x, 36), (x + 14, 48), colour, -1)
        cv2.putText(page, name, (x + 19, 47), FONT, 0.42, INK, 1, cv2.LINE_AA)
        x += 150
    for r, (name, told) in enumerate(rows):
        top = 62 + ROW_PX * r
        cv2.putText(page, name, (12, top + 14), FONT, 0.42, INK, 1, cv2.LINE_AA)
        edges = LEFT_PX + np.rint(np.linspace(0, WIDTH_PX, len(told) + 1)).astype(int)
        for t, left, right in zip(told, edges[:-1], edges[1:], strict=True):
            page[top : top + 15, left:right] = COLOURS[meaning(t)]
            hidden = round(6 * (1.0 - min(t.visib_fract, 1.0)))
            page[top + 16 : top + 16 + hidden, left:right] = HIDDEN
    return page
