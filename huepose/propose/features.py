"""Local image features: detector and descriptor behind the protocol `FeatureSource`.

The default is SIFT (Lowe 2004, OpenCV), which needs no weights; its descriptors are compared as RootSIFT
(Arandjelovic and Zisserman 2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, UInt8

SIFT_WIDTH = 128
"""Numbers in a descriptor."""

RATIO = 0.85
"""Ratio test: descriptor distance of the best match over that of the best one elsewhere. Looser than Lowe's
0.8, because a consensus of matches rejects wrong ones later."""


@dataclass(frozen=True, eq=False)
class Features:
    """pixels (N, 2) float32: (u, v) in the image; descriptors (N, D) float32 of unit length, without
    negative values: similarity is their scalar product, 0..1."""

    pixels: Float32
    descriptors: Float32

    def __len__(self) -> int:
        return len(self.pixels)

    def __getitem__(self, index: np.ndarray) -> Features:
        return Features(self.pixels[index], self.descriptors[index])


def distinct(best: Float32, second: Float32) -> Bool:
    """Which best matches (N,) pass the ratio test against the second best; both by their similarity."""
    return np.asarray(1.0 - best < RATIO**2 * (1.0 - second))


class FeatureSource(Protocol):
    """Finds features. name: only features of one name can be compared."""

    @property
    def name(self) -> str:
        """Name of detector and descriptor."""
        ...

    def extract(self, color: UInt8, mask: Bool | None = None) -> Features:
        """Features of an image (H, W, 3) uint8 RGB, only those on the mask (H, W) if there is one."""
        ...


class Sift:
    """SIFT with OpenCV's settings: its finest scale is that of an image of twice the size."""

    name = "sift"

    def __init__(self) -> None:
        self._sift = cv2.SIFT.create()

    def extract(self, color: UInt8, mask: Bool | None = None) -> Features:
        """Features of an image (H, W, 3) uint8 RGB, only those on the mask (H, W) if there is one."""
        grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        found, plain = self._sift.detectAndCompute(grey, None if mask is None else mask.view(np.uint8))
        if not found:
            return Features(np.zeros((0, 2), np.float32), np.zeros((0, SIFT_WIDTH), np.float32))
        shares = plain / np.maximum(plain.sum(1, keepdims=True), np.float32(1.0))
        return Features(np.array([p.pt for p in found], np.float32), np.sqrt(shares))
