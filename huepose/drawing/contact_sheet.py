"""Many small pictures on one page."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.drawing.canvas import FONT, PAPER, text_px, wrapped
from huepose.geometry.arrays import UInt8

GAP_PX, LABEL_PX, LINE_PX = 6, 22, 16
_SCALE, _SMALLEST = 0.5, 0.4  # scale of a label's letters, usual and smallest; smaller ones cannot be read


def contact_sheet(
    images: Sequence[UInt8],
    columns: int,
    labels: Sequence[str] | None = None,
    cell: tuple[int, int] | None = None,
) -> UInt8:
    """A page (H, W, 3) uint8 RGB of images (h, w, 3) or (h, w) uint8 in rows of `columns`, labels below them.

    Each image is scaled into a cell (width, height) and keeps its aspect ratio. By default a cell is as
    wide as the widest and as high as the highest image. Raises ValueError for no images, or another number
    of labels.
    """
    if not images or columns < 1:
        raise ValueError("a contact sheet needs at least one image and one column")
    if labels is not None and len(labels) != len(images):
        raise ValueError(f"{len(labels)} labels for {len(images)} images")
    width, height = cell or (max(i.shape[1] for i in images), max(i.shape[0] for i in images))
    lines = [_lines(label, width) for label in labels or ()]
    strip = LABEL_PX + LINE_PX * (max(len(texts) for texts, _ in lines) - 1) if lines else 0
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    step_x, step_y = width + GAP_PX, height + strip + GAP_PX
    page: UInt8 = np.full((rows * step_y + GAP_PX, columns * step_x + GAP_PX, 3), PAPER, np.uint8)
    for k, image in enumerate(images):
        x, y = GAP_PX + k % columns * step_x, GAP_PX + k // columns * step_y
        page[y : y + height, x : x + width] = fitted(image, width, height)
        texts, scale = lines[k] if lines else ([], 0.0)
        for row, line in enumerate(texts):
            at = x, y + height + 16 + row * LINE_PX
            cv2.putText(page, line, at, FONT, scale, (30, 30, 30), 1, cv2.LINE_AA)
    return page


def fitted(image: UInt8, width: int, height: int) -> UInt8:
    """The image scaled to fit and centred on a page (height, width, 3); enlarged pixels stay sharp."""
    rgb = np.repeat(image[..., None], 3, 2) if image.ndim == 2 else image
    factor = min(width / rgb.shape[1], height / rgb.shape[0])
    size = (max(1, round(rgb.shape[1] * factor)), max(1, round(rgb.shape[0] * factor)))
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_NEAREST
    small = rgb if factor == 1 else cv2.resize(rgb, size, interpolation=how)
    page: UInt8 = np.full((height, width, 3), PAPER, np.uint8)
    x, y = (width - size[0]) // 2, (height - size[1]) // 2
    page[y : y + size[1], x : x + size[0]] = small
    return page


def _lines(label: str, width: int) -> tuple[list[str], float]:
    """A label broken into as few lines as keep its letters readable, and the scale of its letters."""
    if text_px(label, _SCALE) <= width:
        return [label], _SCALE
    lines = wrapped(label, width, _SMALLEST)
    return lines, _SMALLEST * min(1.0, width / max(text_px(line, _SMALLEST) for line in lines))
