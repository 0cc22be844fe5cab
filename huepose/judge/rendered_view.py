"""Rendered views: the object at a pose, drawn at the resolution and sharpness of this camera, to compare
similar poses.

The samples of a surface (`model.types.Surface`) carry the texture at two fixed scales, whatever the camera
resolves. A rendered view is drawn for one pose and one camera: its samples are pixels, their colours the
texture as this camera would see it, in the same frequency bands as the picture, and it has an outline. It is
valid for small steps from its pose.

The score of a single pose reads the picture where that pose fits, under the light that suits it. Competing
poses are compared more strictly: on the same pixels, where texture that is seen but missing in the view
counts against it, and with the same texture gain for all. Fine detail is compared exactly; broader texture
may be displaced by a pixel or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import LINEAR, bytes_of
from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int64, UInt8
from huepose.geometry.camera import NEAR_M, Camera
from huepose.judge.implied_light import Light
from huepose.judge.region import ModelArrays, model_arrays, smoothed_opponents
from huepose.model.types import ReferenceModel
from huepose.rendering.render import Rendering, render

SHARP_PX, BLUNT_PX = 0.6, 2.5
"""Detail is the band between these two smoothings (sigmas, pixels): light varies more slowly, and the camera
resolves little below it."""

RIM_POINTS = 120
"""Most points of an outline."""

MARGIN_PX, LARGEST_PX = 6, 640
"""Room round the object in a rendered view, and most pixels of its longer side: an object that needs more is
too near."""


@dataclass(frozen=True, eq=False)
class RenderedView:
    """arrays: the model with pixels as its visible samples, and detail and blunt colours in place of the two
    scales; rim_points, rim_inward (N, 3): the outline (see `outline.Rim`)."""

    arrays: ModelArrays
    rim_points: Float64
    rim_inward: Float64


def detail_colors(color: UInt8, weight: Float32) -> Float32:
    """Detail and blunt colours (2, h, w, 3) of a picture (h, w, 3); pixels count by their weight (h, w), over
    0."""
    colors = smoothed_opponents(color, weight, (SHARP_PX, BLUNT_PX))
    colors[0] -= colors[1]
    return colors


def draw_rendered_view(
    model: ReferenceModel, T_cam_obj: Float, camera: Camera, samples: int, light: Light | None = None
) -> RenderedView | None:
    """The rendered view of a pose (4, 4) with at most `samples` samples, in a light where it is given; None
    where it shows too little of the object, or is too near for a picture of it."""
    window = _window(model, T_cam_obj, camera)
    if window is None:
        return None
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    seen = render([(model.mesh, T)], window, normals=True, points=True)
    shown = seen.depth > 0
    rows, columns = _random_pixels(shown, samples)
    rim_rows, rim_columns, inward_px = _rim(shown)
    if len(rows) < 20 or not len(rim_rows):
        return None
    picked = _colors(seen, T, light)[:, rows, columns]
    R = T[:3, :3]
    metres = seen.depth[rim_rows, rim_columns][:, None] / np.array([window.fx, window.fy])
    inward = np.zeros((len(rim_rows), 3))
    inward[:, :2] = inward_px * metres
    base = model_arrays(model)
    first, count = len(base.points), len(rows)
    # Behind the samples of the surface, to which the distance grid refers.
    arrays = base._replace(
        points=_joined(base.points, seen.points_obj[rows, columns]),
        normals=_joined(base.normals, seen.normals_cam[rows, columns] @ R),
        colors=np.stack([_joined(base.colors[k], picked[k]) for k in range(2)]),
        directions=np.array([[0.0, 0.0, 1.0]], np.float32),
        beside=np.empty((1, 0), np.int32),
        visible=np.arange(first, first + count, dtype=np.int32),
        offsets=np.array([0, count], np.int32),
    )
    points = seen.points_obj[rim_rows, rim_columns].astype(np.float64)
    return RenderedView(arrays, np.ascontiguousarray(points), inward @ R)


def _window(model: ReferenceModel, T_cam_obj: Float, camera: Camera) -> Camera | None:
    """The camera of the window round a pose, which may reach out of the picture."""
    points = model.surface.points @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3]
    if points[:, 2].min() < NEAR_M:
        return None
    pixels = camera.project(points)
    low, high = (
        np.floor(pixels.min(0)).astype(int) - MARGIN_PX,
        np.ceil(pixels.max(0)).astype(int) + MARGIN_PX,
    )
    width, height = (int(x) for x in high - low)
    if max(width, height) > LARGEST_PX:
        return None
    return camera.cropped(int(low[0]), int(low[1]), width, height)


def _random_pixels(mask: Bool, count: int) -> tuple[Int64, Int64]:
    """Rows and columns of at most `count` pixels of a mask, in random order."""
    rows, columns = np.nonzero(mask)
    keep = np.random.default_rng(len(rows)).permutation(len(rows))[:count]
    return rows[keep], columns[keep]


def _rim(shown: Bool) -> tuple[Int64, Int64, Float64]:
    """Rows, columns and inward directions (N, 2), x and y, of at most RIM_POINTS pixels of the outline."""
    filled = shown.astype(np.uint8)
    rows, columns = _random_pixels(shown & (cv2.erode(filled, np.ones((3, 3), np.uint8)) == 0), RIM_POINTS)
    soft = cv2.GaussianBlur(filled.astype(np.float32), (0, 0), 1.2)
    x = cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3)[rows, columns]
    y = cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=3)[rows, columns]
    inward = np.stack([x, y], axis=-1).astype(np.float64)
    return rows, columns, inward / (np.linalg.norm(inward, axis=-1, keepdims=True) + 1e-9)


def _joined(base: Float32, more: Float) -> Float32:
    return np.ascontiguousarray(np.concatenate([base, more]), dtype=np.float32)


BROAD_PX = 5.0
"""Sigma, pixels: broader texture is the band between the blunt smoothing and this one; shading is broader
still."""

MAX_SHIFT = 1
"""Largest displacement of a patch of texture, pixels at half resolution."""

PATCH = 5
"""Side of such a patch, pixels at half resolution."""

NOISE = 1.0
"""Noise of detail, opponent units: that of a picture without texture."""

MIN_GAIN, MAX_GAIN = 0.3, 1.2
"""Limits of the gain of the seen texture over the mesh's: veiled by gloss and blur, or sharper than it was
scanned."""

MIN_PIXELS = 20
"""Least number of pixels on which poses are compared."""


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


def likeness(
    model: ReferenceModel, part: Part, poses: Float64, lights: Sequence[Light | None]
) -> Likeness | None:
    """How well each of the poses (K, 4, 4), in its light (K), explains the pixels where any of them lies;
    None where these are too few."""
    seen = [_seen(model, part, T, light) for T, light in zip(poses, lights, strict=True)]
    shared = np.any([one.comparable for one in seen], axis=0)
    if int(shared.sum()) < MIN_PIXELS:
        return None
    return Likeness(_detail(part.colors, seen, shared), _broad(part.colors, seen, shared))


def _seen(model: ReferenceModel, part: Part, T_cam_obj: Float64, light: Light | None) -> _Seen:
    T = np.ascontiguousarray(T_cam_obj)
    picture = render([(model.mesh, T)], part.camera, normals=light is not None)
    shown = picture.depth > 0
    fits = (part.depth == 0) | (np.abs(part.depth - picture.depth) < part.tolerance_m)
    return _Seen(_colors(picture, T, light), shown & fits & ~part.saturated)


def _colors(picture: Rendering, T_cam_obj: Float64, light: Light | None) -> Float32:
    """Detail and blunt colours of a rendered pose (4, 4) in a light; lightness, which shading changes most,
    is left as it is."""
    shown = picture.depth > 0
    weight = np.maximum(shown, np.float32(1e-6))
    colors = detail_colors(picture.color, weight)
    if light is not None:
        normals = picture.normals_cam[shown] @ T_cam_obj[:3, :3].astype(np.float32)
        lit = picture.color.copy()
        lit[shown] = bytes_of(LINEAR[lit[shown]] * light.on(normals)[:, None])
        colors[..., 1:] = detail_colors(lit, weight)[..., 1:]
    return colors


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
    unexplained = _patch_means(_saturating(picture / spread))
    out = []
    for texture, weight in zip(textures, weights, strict=True):
        strong = texture * gain
        left = np.full(weight.shape, np.inf, np.float32)
        for dx in range(-MAX_SHIFT, MAX_SHIFT + 1):
            for dy in range(-MAX_SHIFT, MAX_SHIFT + 1):
                moved = np.roll(strong, (dy, dx), axis=(0, 1))
                left = np.minimum(left, _patch_means(_saturating((picture - moved) / spread)))
        out.append(float(((unexplained - left) * weight).sum()) / count)
    return np.array(out)


def _shared_gain(picture: Float32, textures: Sequence[Float32], count: float) -> Float32:
    """Gain (3,) per channel of the picture's texture over that of the pose that fits best."""
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


def _saturating(x: Float32) -> Float32:
    square = x * x
    return np.asarray(square / (1.0 + square), dtype=np.float32)


def _patch_means(x: Float32) -> Float32:
    """Sum over the channels, averaged over the patch around each pixel."""
    total = x[..., 0] + x[..., 1] + x[..., 2]
    return np.asarray(cv2.boxFilter(total, -1, (PATCH, PATCH)), dtype=np.float32)
