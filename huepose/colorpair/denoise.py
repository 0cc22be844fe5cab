"""Chroma noise out, edges kept: the first step of colour pair extraction (paper, section III-B,
preprocessing).

Two passes of a small bilateral filter on the colours, then a joint bilateral filter on a and b that is
guided by L: real sensors are noisier in colour than in lightness, so lightness says where the edges are.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Int, UInt8
from huepose.support.jit import jit


@dataclass(frozen=True)
class DenoiseConfig:
    """window: side of the filters in pixels; sigma_space in pixels; sigma_color in 8-bit steps of each pass
    of the bilateral filter; sigma_guide in units of L."""

    window: int = 5
    sigma_space: float = 1.5
    sigma_color: tuple[float, ...] = (20.0, 14.0)
    sigma_guide: float = 6.0


def to_lab(color: UInt8) -> Float32:
    """CIELAB (H, W, 3) float32, L 0..100, of an sRGB image (H, W, 3) uint8."""
    return np.asarray(cv2.cvtColor(color.astype(np.float32) * np.float32(1 / 255), cv2.COLOR_RGB2Lab))


def denoise(color: UInt8, config: DenoiseConfig | None = None) -> Float32:
    """CIELAB (H, W, 3) float32 of an sRGB image (H, W, 3) uint8 RGB, noise removed and edges kept.

    A constant image comes back unchanged up to rounding.
    """
    config = config or DenoiseConfig()
    smooth = np.ascontiguousarray(color)
    for sigma in config.sigma_color:
        smooth = np.asarray(cv2.bilateralFilter(smooth, config.window, sigma, config.sigma_space), np.uint8)
    return joint_bilateral(to_lab(smooth), config.window // 2, config.sigma_space, config.sigma_guide)


def joint_bilateral(lab: Float32, radius: int, sigma_space: float, sigma_guide: float) -> Float32:
    """Filter a and b of a CIELAB image (H, W, 3) with weights of distance and of the difference in L.

    L is returned as it is. The window is round, of the given radius in pixels; at borders it is cut.
    """
    span = np.arange(-radius, radius + 1)
    dv, du = (a.ravel() for a in np.meshgrid(span, span, indexing="ij"))
    inside = du**2 + dv**2 <= (radius + 0.3) ** 2
    du, dv = du[inside], dv[inside]
    space = np.exp(-(du**2 + dv**2) / (2.0 * sigma_space**2)).astype(np.float32)
    steps = np.arange(256, dtype=np.float32) * (3.0 * sigma_guide / 255.0)
    table = np.exp(-(steps**2) / (2.0 * sigma_guide**2)).astype(np.float32)
    table[-1] = 0.0
    scale = 255.0 / (3.0 * sigma_guide)
    return _joint_bilateral(np.ascontiguousarray(lab, np.float32), du, dv, space, table, scale)


@jit
def _joint_bilateral(lab: Float32, du: Int, dv: Int, space: Float32, table: Float32, scale: float) -> Float32:
    height, width = lab.shape[0], lab.shape[1]
    out = np.empty_like(lab)
    for v in range(height):
        for u in range(width):
            lightness = lab[v, u, 0]
            total = np.float32(0.0)
            a = np.float32(0.0)
            b = np.float32(0.0)
            for k in range(du.shape[0]):
                y, x = v + dv[k], u + du[k]
                if y < 0 or x < 0 or y >= height or x >= width:
                    continue
                i = int(abs(lab[y, x, 0] - lightness) * scale)
                if i > 254:
                    continue
                w = space[k] * table[i]
                total += w
                a += w * lab[y, x, 1]
                b += w * lab[y, x, 2]
            out[v, u, 0] = lightness
            out[v, u, 1] = a / total
            out[v, u, 2] = b / total
    return out
