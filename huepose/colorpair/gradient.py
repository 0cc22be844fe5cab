"""One gradient for a colour image: the energy of all channels, the direction of the strongest (paper,
III-B)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float32
from huepose.support.jit import jit


@dataclass(frozen=True, eq=False)
class Gradient:
    """magnitude (H, W) float32: change of CIELAB per pixel, all channels together; direction (H, W, 2)
    float32: unit vector (du, dv) along the gradient of the channel that changes most, 0 where nothing
    changes."""

    magnitude: Float32
    direction: Float32


def unified_gradient(lab: Float32) -> Gradient:
    """Gradient of a CIELAB image (H, W, 3) float32, by Scharr's derivative.

    On a linear ramp of s units per pixel in each of k channels the magnitude is s sqrt(k). A colour ramp
    whose channels run in opposite directions keeps its energy: only the direction is taken from one channel.
    """
    du = np.asarray(cv2.Scharr(lab, cv2.CV_32F, 1, 0, scale=1 / 32), np.float32)
    dv = np.asarray(cv2.Scharr(lab, cv2.CV_32F, 0, 1, scale=1 / 32), np.float32)
    return Gradient(*_combine(du, dv))


@jit
def _combine(du: Float32, dv: Float32) -> tuple[Float32, Float32]:
    height, width = du.shape[0], du.shape[1]
    magnitude = np.zeros((height, width), np.float32)
    direction = np.zeros((height, width, 2), np.float32)
    for v in range(height):
        for u in range(width):
            energy = np.float32(0.0)
            strongest = np.float32(0.0)
            channel = 0
            for c in range(3):
                e = du[v, u, c] * du[v, u, c] + dv[v, u, c] * dv[v, u, c]
                energy += e
                if e > strongest:
                    strongest = e
                    channel = c
            if strongest > 1e-12:
                length = np.sqrt(strongest)
                magnitude[v, u] = np.sqrt(energy)
                direction[v, u, 0] = du[v, u, channel] / length
                direction[v, u, 1] = dv[v, u, channel] / length
    return magnitude, direction
