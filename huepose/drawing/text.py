"""Lines of text on paper."""

from __future__ import annotations

import cv2
import numpy as np

from huepose.drawing.canvas import FONT, INK, PAPER
from huepose.geometry.arrays import UInt8

LINE_PX, MARGIN_PX = 18, 8


def paragraph(text: str, width: int, scale: float = 0.45) -> UInt8:
    """Text broken into lines on a strip of paper (H, width, 3) uint8 RGB. A word that is wider than the strip
    stands in a line of its own, cut off."""
    lines: list[str] = []
    for words in (part.split() for part in text.split("\n")):
        line = ""
        for word in words:
            longer = f"{line} {word}".strip()
            fits = cv2.getTextSize(longer, FONT, scale, 1)[0][0] <= width - 2 * MARGIN_PX
            if line and not fits:
                lines.append(line)
            line = longer if fits or not line else word
        lines.append(line)
    page: UInt8 = np.full((LINE_PX * len(lines) + MARGIN_PX, width, 3), PAPER, np.uint8)
    for k, line in enumerate(lines):
        cv2.putText(page, line, (MARGIN_PX, LINE_PX * (k + 1)), FONT, scale, INK, 1, cv2.LINE_AA)
    return page
