"""How well each of several competing poses explains the same pixels.

The score of a single pose reads the image where that pose fits, under the light that suits it. Competing
poses are compared more strictly: on the same pixels and with the same texture gain. Texture that the image
shows and a pose lacks counts against that pose. Fine detail is compared exactly; broader texture may be
displaced by a pixel or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.judge.implied_light import Light
from huepose.judge.rendered_view import rendered_colors
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render
from huepose.support.jit import jit

BROAD_PX = 5.0
"""Sigma, pixels: broader texture is the band between the blunt smoothing and this one; shading varies even
more slowly."""

MAX_SHIFT = 1
"""Largest displacement of a patch of texture, pixels at half resolution."""

PATCH = 5
"""Side of such a patch, pixels at half resolution."""

NOISE = 1.0
"""Noise of detail, opponent units: that of an image without texture."""

MIN_GAIN, MAX_GAIN = 0.3, 1.2
"""Limits of the gain of the image's texture over the mesh's: low through gloss and blur, high if the image is
sharper than the scan."""

MIN_PIXELS = 20
"""Least number of pixels on which poses are compared."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an image. camera: of the part; colors (2, h, w, 3): see `detail_colors`; depth (h, w) metres;
    saturated (h, w); tolerance_m: a pixel shows a pose if its depth differs by less than this, or is
    unknown."""

    camera: Camera
    colors: Float32
    depth: Float32
    saturated: Bool
    tolerance_m: float


@dataclass(frozen=True, eq=False)
class Likeness:
    """Of each pose (K,): `detail`, correlation of fine detail times the share of the pixels on which it could
    be compared, in -1..1; `broad`, how much of the broader texture it explains, robustly, in -3..3."""

    detail: Float64
    broad: Float64


@dataclass(frozen=True, eq=False)
class _Seen:
    """The rendered view of a pose in the window: detail and blunt colours (2, h, w, 3), and the pixels on
    which they can be compared."""

    colors: Float32
    comparable: Bool


def likeness(
    model: ReferenceModel, part: Part, poses: Float64, lights: Sequence[Light | None]
) -> Likeness | None:
    """How well each of the poses (K, 4, 4), in its light (K), explains the pixels that any of them shows;
    None if these are too few."""
    seen = [_seen(model, part, T, light) for T, light in zip(poses, lights, strict=True)]
    shared = np.any([one.comparable for one in seen], axis=0)
    if int(shared.sum()) < MIN_PIXELS:
        return None
    return Likeness(_detail(part.colors, seen, shared), _broad(part.colors, seen, shared))


def _seen(model: ReferenceModel, part: Part, T_cam_obj: Float64, light: Light | None) -> _Seen:
    T = np.ascontiguousarray(T_cam_obj)
    picture = render([(model.mesh, T)], part.camera)
    shown = picture.depth > 0
    fits = (part.depth == 0) | (np.abs(part.depth - picture.depth) < part.tolerance_m)
    return _Seen(rendered_colors(picture, T, light), shown & fits & ~part.saturated)


def _detail(colors: Float32, seen: Sequence[_Seen], shared: Bool) -> Float64:
    count = float(shared.sum())
    out = []
    for one in seen:
        product, picture, texture = _products(colors[0], one.colors[0], one.comparable)
        correlation = product / np.sqrt(picture * texture + (count * NOISE**2) ** 2)
        out.append(correlation * float(one.comparable.sum()) / count)
    return np.array(out)


@jit
def _products(picture: Float32, texture: Float32, mask: Bool) -> tuple[float, float, float]:
    """Sums over a mask (h, w) and the channels: of the product of two images (h, w, 3), of the square of the
    first and of the second."""
    product, of_picture, of_texture = 0.0, 0.0, 0.0
    for v in range(mask.shape[0]):
        for u in range(mask.shape[1]):
            if mask[v, u]:
                for c in range(3):
                    a, b = np.float64(picture[v, u, c]), np.float64(texture[v, u, c])
                    product += a * b
                    of_picture += a * a
                    of_texture += b * b
    return product, of_picture, of_texture


def _broad(colors: Float32, seen: Sequence[_Seen], shared: Bool) -> Float64:
    everywhere = _halved(shared.astype(np.float32))
    picture = _band(_halved(colors[1] * shared[..., None]), everywhere)
    weights = [_halved(one.comparable.astype(np.float32)) for one in seen]
    textures = [
        _band(_halved(one.colors[1] * one.comparable[..., None]), weight)
        for one, weight in zip(seen, weights, strict=True)
    ]
    count = float(everywhere.sum())
    energy = np.einsum("ijk,ijk->k", picture, picture)
    spread = np.sqrt(energy / count) + NOISE
    gain = _shared_gain(picture, textures, count)
    unexplained = _patch_means(_residual(picture, np.zeros_like(picture), gain, spread, 0, 0))
    out = []
    for texture, weight in zip(textures, weights, strict=True):
        residual = np.full(weight.shape, np.inf, np.float32)
        for dx in range(-MAX_SHIFT, MAX_SHIFT + 1):
            for dy in range(-MAX_SHIFT, MAX_SHIFT + 1):
                residual = np.minimum(
                    residual, _patch_means(_residual(picture, texture, gain, spread, dy, dx))
                )
        out.append(float(((unexplained - residual) * weight).sum()) / count)
    return np.array(out)


@jit
def _residual(
    picture: Float32, texture: Float32, gain: Float32, spread: Float32, dy: int, dx: int
) -> Float32:
    """Squared residual (h, w) of an image (h, w, 3) after subtraction of a texture (h, w, 3) with a gain
    (3,), displaced by (dy, dx) pixels: in units of the spreads (3,), saturating, summed over the channels."""
    height, width = picture.shape[:2]
    out = np.empty((height, width), np.float32)
    per_spread = np.float32(1.0) / spread
    for v in range(height):
        row = (v - dy) % height
        for u in range(width):
            column, total = (u - dx) % width, np.float32(0.0)
            for c in range(3):
                x = (picture[v, u, c] - texture[row, column, c] * gain[c]) * per_spread[c]
                square = x * x
                total += square / (np.float32(1.0) + square)
            out[v, u] = total
    return out


def _shared_gain(picture: Float32, textures: Sequence[Float32], count: float) -> Float32:
    """Gain (3,) per channel of the image's texture over the rendered one: the largest of all poses, within
    the limits."""
    gains = [
        np.einsum("ijk,ijk->k", picture, texture)
        / (np.einsum("ijk,ijk->k", texture, texture) + NOISE * np.sqrt(count))
        for texture in textures
    ]
    return np.asarray(np.clip(np.max(gains, axis=0), MIN_GAIN, MAX_GAIN), dtype=np.float32)


def _halved(picture: Float32) -> Float32:
    height, width = picture.shape[:2]
    size = (max(width // 2, 1), max(height // 2, 1))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _band(weighted: Float32, weight: Float32) -> Float32:
    """Band-pass: weighted colours (h, w, 3) minus their local mean, 0 where the weight (h, w) is 0."""
    sigma = 0.5 * BROAD_PX
    mean = cv2.GaussianBlur(weighted, (0, 0), sigma) / (
        cv2.GaussianBlur(weight, (0, 0), sigma)[..., None] + 1e-3
    )
    return np.asarray(weighted - mean * weight[..., None], dtype=np.float32)


def _patch_means(x: Float32) -> Float32:
    """Averaged over the patch around each pixel (h, w)."""
    return np.asarray(cv2.boxFilter(x, -1, (PATCH, PATCH)), dtype=np.float32)
