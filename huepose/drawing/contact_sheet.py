"""Many small pictures on one page."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.drawing.canvas import FONT, PAPER
from huepose.geometry.arrays import UInt8

GAP_PX, LABEL_PX = 6, 22


def contact_sheet(
    images: Sequence[UInt8],
    columns: int,
    labels: Sequence[str] | None = None,
    cell: tuple[int, int] | None = None,
) -> UInt8:
    """A page (H, W, 3) uint8 RGB of images (h, w, 3) or (h, w) uint8 in rows of `columns`, labels below them.

    Each image is scaled, its proportions kept, into a cell (width, height), by default as large as the
    largest image. Raises ValueError without images or when the labels are not as many.
    """
    if not images or columns < 1:
        raise ValueError("a contact sheet needs at least one image and one column")
    if labels is not None and len(labels) != len(images):
        raise ValueError(f"{len(labels)} labels for {len(images)} images")
    width, height = cell or (max(i.shape[1] for i in images), max(i.shape[0] for i in images))
    strip = LABEL_PX if labels is not None else 0
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    step_x, step_y = width + GAP_PX, height + strip + GAP_PX
    page: UInt8 = np.full((rows * step_y + GAP_PX, columns * step_x + GAP_PX, 3), PAPER, np.uint8)
    for k, image in enumerate(images):
        x, y = GAP_PX + k % columns * step_x, GAP_PX + k // columns * step_y
        page[y : y + height, x : x + width] = fitted(image, width, height)
        if labels is not None:
            _caption(page, labels[k], x, y + height, width)
    return page


def fitted(image: UInt8, width: int, height: int) -> UInt8:
    """The image scaled to fit and centred on paper (height, width, 3); enlarged pixels stay square."""
    rgb = np.repeat(image[..., None], 3, 2) if image.ndim == 2 else image
    factor = min(width / rgb.shape[1], height / rgb.shape[0])
    size = (max(1, round(rgb.shape[1] * factor)), max(1, round(rgb.shape[0] * factor)))
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_NEAREST
    small = rgb if factor == 1 else cv2.resize(rgb, size, interpolation=how)
    page: UInt8 = np.full((height, width, 3), PAPER, np.uint8)
    x, y = (width - size[0]) // 2, (height - size[1]) // 2
    page[y : y + size[1], x : x + size[0]] = small
    return page


def _caption(page: UInt8, text: str, x: int, y: int, width: int) -> None:
    (long, _), _ = cv2.getTextSize(text, FONT, 0.5, 1)
    scale = 0.5 * min(1.0, width / max(long, 1))
    cv2.putText(page, text, (x, y + 16), FONT, scale, (30, 30, 30), 1, cv2.LINE_AA)
