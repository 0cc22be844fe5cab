"""Colour pairs of an image, from pixels to two colours per edge point (paper, section III-B, all of it).

First chroma noise is taken out and edges are kept: two passes of a small bilateral filter on the colours,
then a joint bilateral filter on a and b that is guided by L, because real sensors are noisier in colour than
in lightness, so lightness says where the edges are.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from huepose.colorpair.ridges import RidgeConfig, Ridges, find_ridges, unified_gradient
from huepose.colorpair.sampling import SamplingConfig, sample_sides
from huepose.colorpair.types import ColorPairs
from huepose.geometry.arrays import Bool, Float32, Int, UInt8
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


MARGIN = 8
"""Pixels round a mask that filters may look at."""

MASK_SHARE = 200
"""Of 255: a pixel of a smaller picture belongs to the mask when nearly all of its area does."""


@dataclass(frozen=True)
class ExtractionConfig:
    """spacing: smallest distance of two ridge points in pixels, made larger until at most `max_pairs` remain;
    min_contrast: smallest CIELAB distance of the two colours of a pair."""

    denoise: DenoiseConfig = field(default_factory=DenoiseConfig)
    ridges: RidgeConfig = field(default_factory=RidgeConfig)
    sampling: SamplingConfig = field(default_factory=SamplingConfig)
    spacing: float = 2.0
    max_pairs: int = 1500
    min_contrast: float = 6.0


@dataclass(frozen=True, eq=False)
class Picture:
    """A part of an image, denoised and at the scale of extraction.

    lab (h, w, 3) float32 CIELAB. Pixel (u, v) of it is ((u + 0.5) sx - 0.5 + x0, (v + 0.5) sy - 0.5 + y0)
    of the image; width, height: of the part, in pixels of the image.
    """

    lab: Float32
    x0: int
    y0: int
    width: int
    height: int

    @property
    def steps(self) -> tuple[float, float]:
        """sx, sy: pixels of the image for one of the picture."""
        return self.width / self.lab.shape[1], self.height / self.lab.shape[0]


def extract(
    color: UInt8, mask: Bool | None = None, config: ExtractionConfig | None = None, scale: float = 1.0
) -> ColorPairs:
    """Colour pairs of an sRGB image (H, W, 3) uint8 RGB, strongest edges first.

    With a mask (H, W) only its surroundings are looked at, and both sides of every pair lie inside it.
    With a `scale` under 1 the image is made smaller by that factor first, so that an object has edges of
    the same kind near and far; positions and widths are given in pixels of `color` all the same.
    """
    config = config or ExtractionConfig()
    window = (0, 0, color.shape[1], color.shape[0]) if mask is None else bounds(mask, MARGIN)
    picture = prepare_picture(color, window, scale, config)
    return extract_pairs(picture, mask, config)


def prepare_picture(
    color: UInt8, window: tuple[int, int, int, int], scale: float, config: ExtractionConfig | None = None
) -> Picture:
    """Cut the window (left, top, right, bottom) out of an image, make it smaller by `scale`, and denoise
    it."""
    x0, y0, x1, y1 = window
    part = color[y0:y1, x0:x1]
    if scale < 1.0 and part.size:
        size = (max(round((x1 - x0) * scale), 8), max(round((y1 - y0) * scale), 8))
        part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
    if not part.size:
        return Picture(np.zeros((0, 0, 3), np.float32), x0, y0, 0, 0)
    return Picture(denoise(part, (config or ExtractionConfig()).denoise), x0, y0, x1 - x0, y1 - y0)


def extract_pairs(
    picture: Picture, mask: Bool | None = None, config: ExtractionConfig | None = None
) -> ColorPairs:
    """Colour pairs of a picture, inside a mask (H, W) of the whole image; see `extract`."""
    config = config or ExtractionConfig()
    height, width = picture.lab.shape[:2]
    if height < 8 or width < 8:
        return ColorPairs.empty()
    inside = np.ones((height, width), np.bool_)
    if mask is not None:
        part = mask[picture.y0 : picture.y0 + picture.height, picture.x0 : picture.x0 + picture.width]
        share = cv2.resize(
            part.astype(np.uint8) * np.uint8(255), (width, height), interpolation=cv2.INTER_AREA
        )
        inside = np.asarray(share > MASK_SHARE)
    pairs = _extract(picture.lab, inside, config)
    steps = np.array(picture.steps)
    pixels = (pairs.pixels + 0.5) * steps - 0.5 + np.array([picture.x0, picture.y0])
    return replace(
        pairs, pixels=pixels.astype(np.float32), widths=(pairs.widths * steps.mean()).astype(np.float32)
    )


def _extract(lab: Float32, mask: Bool, config: ExtractionConfig) -> ColorPairs:
    """Colour pairs of a denoised CIELAB image (H, W, 3), in its own pixels."""
    ridges = find_ridges(unified_gradient(lab), mask, config.ridges)
    order = np.argsort(-ridges.strengths, kind="stable")
    ridges = _take(ridges, order)
    colors, valid = sample_sides(lab, ridges, mask, config.sampling)
    contrast = np.linalg.norm(colors[:, 1] - colors[:, 0], axis=1)
    valid &= contrast >= config.min_contrast
    ridges, colors = _take(ridges, valid), colors[valid]
    kept = thinned(ridges.pixels, lab.shape[0], lab.shape[1], config.spacing, config.max_pairs)
    ridges, colors = _take(ridges, kept), colors[kept]
    angles = np.arctan2(ridges.directions[:, 1], ridges.directions[:, 0])
    return ColorPairs(ridges.pixels, angles.astype(np.float32), ridges.widths, colors)


def thinned(pixels: Float32, height: int, width: int, spacing: float, limit: int) -> Bool:
    """Which of the points (N, 2), best first, to keep so that none is nearer than `spacing` to a better one.

    When more than `limit` are left, the spacing is made larger by a quarter until they are not.
    """
    while True:
        kept = _thin(pixels, height, width, spacing)
        if int(kept.sum()) <= limit:
            return kept
        spacing *= 1.25


def bounds(mask: Bool, margin: int = 0) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of a mask (H, W), grown by a margin and cut at the image; zeros when empty."""
    height, width = mask.shape
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return 0, 0, 0, 0
    return (
        max(int(columns[0]) - margin, 0),
        max(int(rows[0]) - margin, 0),
        min(int(columns[-1]) + 1 + margin, width),
        min(int(rows[-1]) + 1 + margin, height),
    )


def _take(ridges: Ridges, index: np.ndarray) -> Ridges:
    return Ridges(
        ridges.cells[index],
        ridges.pixels[index],
        ridges.directions[index],
        ridges.strengths[index],
        ridges.widths[index],
    )


@jit
def _thin(pixels: Float32, height: int, width: int, spacing: float) -> Bool:
    cell = spacing
    rows, columns = int(height / cell) + 2, int(width / cell) + 2
    head = np.full((rows, columns), -1, np.int32)
    follow = np.full(pixels.shape[0], -1, np.int32)
    kept = np.zeros(pixels.shape[0], np.bool_)
    for i in range(pixels.shape[0]):
        r, c = int(pixels[i, 1] / cell), int(pixels[i, 0] / cell)
        free = True
        for y in range(max(r - 1, 0), min(r + 2, rows)):
            for x in range(max(c - 1, 0), min(c + 2, columns)):
                j = head[y, x]
                while j >= 0 and free:
                    du, dv = pixels[i, 0] - pixels[j, 0], pixels[i, 1] - pixels[j, 1]
                    if du * du + dv * dv < spacing * spacing:
                        free = False
                    j = follow[j]
        if free:
            kept[i] = True
            follow[i] = head[r, c]
            head[r, c] = i
    return kept
