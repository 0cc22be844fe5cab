"""Which of several poses explains the same pixels best? Textures against the picture where any of them lies.

A score of one pose alone reads the picture where that pose fits it, and under the light that suits it. Of
poses that compete for one answer more can be asked: that they explain the same pixels, where what shows and
is not in their texture speaks against them, and that the texture is as strong in one as in the other. Fine
detail is compared as the mesh has it; of broader texture no more is asked than that it is there within a
pixel or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.judge.rendered_view import detail_colors
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render

BROAD_PX = 5.0
"""Broader texture lies between the blunt smoothing of a rendered view and this one; shading is broader."""

REACH = 1
"""Half-size pixels by which a piece of the texture may be elsewhere."""

PIECE = 5
"""Side of such a piece, in half-size pixels."""

NOISE = 1.0
"""Opponents: of the detail of a picture that shows nothing."""

WEAKEST, STRONGEST = 0.3, 1.2
"""Of a texture against that of the mesh: veiled by gloss and blur, or sharper than it was scanned."""

FEWEST = 20
"""Pixels on which poses can be compared."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a picture. camera: of the part; colors (2, h, w, 3): as `detail_colors` has them; depth
    (h, w) metres; saturated (h, w); a pixel shows a pose when its depth is at most `tolerance_m` off, or
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
    """What a pose shows in the window: detail and blunt colours (2, h, w, 3), and where they may be
    compared."""

    colors: Float32
    comparable: Bool


def likeness(model: ReferenceModel, part: Part, poses: Float64) -> Likeness | None:
    """How well each of the poses (K, 4, 4) explains what a picture shows where any of them lies; None where
    that is too few pixels."""
    seen = [_seen(model, part, T) for T in poses]
    shared = np.any([one.comparable for one in seen], axis=0)
    if int(shared.sum()) < FEWEST:
        return None
    return Likeness(_detail(part.colors, seen, shared), _broad(part.colors, seen, shared))


def _seen(model: ReferenceModel, part: Part, T_cam_obj: Float64) -> _Seen:
    picture = render([(model.mesh, np.ascontiguousarray(T_cam_obj))], part.camera)
    shown = picture.depth > 0
    fits = (part.depth == 0) | (np.abs(part.depth - picture.depth) < part.tolerance_m)
    colors = detail_colors(picture.color, np.maximum(shown, np.float32(1e-6)))
    return _Seen(colors, shown & fits & ~part.saturated)


def _detail(colors: Float32, seen: Sequence[_Seen], shared: Bool) -> Float64:
    count = float(shared.sum())
    everywhere = np.ascontiguousarray(colors[0] * shared[..., None])
    out = []
    for one in seen:
        there = one.comparable[..., None]
        correlation = _correlation(everywhere * there, one.colors[0] * there, count)
        out.append(correlation * float(one.comparable.sum()) / count)
    return np.array(out)


def _correlation(picture: Float32, texture: Float32, count: float) -> float:
    strength = float((picture * picture).sum()) * float((texture * texture).sum())
    return float((picture * texture).sum()) / float(np.sqrt(strength + (count * NOISE**2) ** 2))


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
    unexplained = _pieces(_saturating(picture / spread))
    out = []
    for texture, weight in zip(textures, weights, strict=True):
        strong = texture * gain
        left = np.full(weight.shape, np.inf, np.float32)
        for dx in range(-REACH, REACH + 1):
            for dy in range(-REACH, REACH + 1):
                moved = np.roll(strong, (dy, dx), axis=(0, 1))
                left = np.minimum(left, _pieces(_saturating((picture - moved) / spread)))
        out.append(float(((unexplained - left) * weight).sum()) / count)
    return np.array(out)


def _shared_gain(picture: Float32, textures: Sequence[Float32], count: float) -> Float32:
    """How strong the texture shows in the picture (3,), by channel, after whom it suits best."""
    gains = [
        np.einsum("ijk,ijk->k", picture, texture)
        / (np.einsum("ijk,ijk->k", texture, texture) + NOISE * np.sqrt(count))
        for texture in textures
    ]
    return np.asarray(np.clip(np.max(gains, axis=0), WEAKEST, STRONGEST), dtype=np.float32)


def _halved(picture: Float32) -> Float32:
    height, width = picture.shape[:2]
    size = (max(width // 2, 1), max(height // 2, 1))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _band(weighted: Float32, weight: Float32) -> Float32:
    """Weighted colours (h, w, 3) less their mean round about, 0 where the weight (h, w) is."""
    sigma = 0.5 * BROAD_PX
    mean = cv2.GaussianBlur(weighted, (0, 0), sigma) / (
        cv2.GaussianBlur(weight, (0, 0), sigma)[..., None] + 1e-3
    )
    return np.asarray(weighted - mean * weight[..., None], dtype=np.float32)


def _saturating(x: Float32) -> Float32:
    square = x * x
    return np.asarray(square / (1.0 + square), dtype=np.float32)


def _pieces(x: Float32) -> Float32:
    """Sum over the channels, averaged over the piece round each pixel."""
    total = x[..., 0] + x[..., 1] + x[..., 2]
    return np.asarray(cv2.boxFilter(total, -1, (PIECE, PIECE)), dtype=np.float32)
