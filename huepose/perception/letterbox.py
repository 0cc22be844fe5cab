"""A picture made to fit a network's input: scaled to fit, the rest filled; and boxes brought back."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Float64, UInt8

_GREY = 114


@dataclass(frozen=True)
class Letterbox:
    """How a picture of a size lies in an input: scale, and the pixels left and above it."""

    scale: float
    left: int
    top: int

    @staticmethod
    def of(image_size: tuple[int, int], input_size: tuple[int, int], centered: bool) -> Letterbox:
        """Of a picture (height, width) in an input (height, width): in its middle, or its corner."""
        scale = min(input_size[0] / image_size[0], input_size[1] / image_size[1])
        height, width = round(image_size[0] * scale), round(image_size[1] * scale)
        if not centered:
            return Letterbox(scale, 0, 0)
        # Half a pixel goes to the right and below, as in the networks' own training.
        left = round((input_size[1] - width) / 2 - 0.1)
        top = round((input_size[0] - height) / 2 - 0.1)
        return Letterbox(scale, left, top)

    def apply(self, image: UInt8, input_size: tuple[int, int]) -> UInt8:
        """The picture (H, W, 3) in an input of that (height, width), the rest grey."""
        size = (round(image.shape[1] * self.scale), round(image.shape[0] * self.scale))
        resized = (
            image if size == image.shape[1::-1] else cv2.resize(image, size).astype(np.uint8, copy=False)
        )
        return self.filled(resized, input_size)

    def filled(self, scaled: UInt8, input_size: tuple[int, int]) -> UInt8:
        """The same for a picture that has the scale of the input already."""
        out = np.full((*input_size, 3), _GREY, np.uint8)
        height, width = scaled.shape[:2]
        out[self.top : self.top + height, self.left : self.left + width] = scaled
        return out

    def back(self, corners: Float) -> Float64:
        """Boxes (N, 4) x0 y0 x1 y1 of the input in pixels of the picture."""
        offset = np.array([self.left, self.top, self.left, self.top], dtype=np.float64)
        return np.asarray((np.asarray(corners, np.float64) - offset) / self.scale)


def suppress_overlaps(corners: Float, scores: Float, classes: np.ndarray, overlap: float) -> np.ndarray:
    """Indices of the boxes to keep, best first: of two of a class with a higher IoU only the better one.

    corners (N, 4) x0 y0 x1 y1, scores (N,), classes (N,)."""
    order = np.argsort(-scores, kind="stable")
    areas = np.prod(np.maximum(corners[:, 2:] - corners[:, :2], 0.0), axis=1)
    kept: list[int] = []
    while len(order):
        best, order = int(order[0]), order[1:]
        kept.append(best)
        low = np.maximum(corners[best, :2], corners[order, :2])
        high = np.minimum(corners[best, 2:], corners[order, 2:])
        common = np.prod(np.maximum(high - low, 0.0), axis=1)
        iou = common / np.maximum(areas[best] + areas[order] - common, 1e-12)
        order = order[(iou <= overlap) | (classes[order] != classes[best])]
    return np.array(kept, dtype=np.intp)
