"""Rendered views: the object at a pose, rendered at the resolution and sharpness of this camera, to compare
similar poses.

The samples of a surface (`model.types.Surface`) carry the texture at two fixed scales, whatever the camera
resolves. A rendered view belongs to one pose and one camera: its samples are pixels, their colours the
texture as this camera would see it, in the same frequency bands as the image, and it has an outline. It is
valid for small steps from its pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int64, UInt8
from huepose.geometry.camera import NEAR_M, Camera
from huepose.judge.implied_light import Light
from huepose.judge.kernel_arrays import ModelArrays, model_arrays
from huepose.judge.region import smoothed_opponents
from huepose.model.types import ReferenceModel
from huepose.rendering.render import Rendering, render

SHARP_PX, BLUNT_PX = 0.6, 2.5
"""Detail is the band between these two smoothings (sigmas, pixels): light varies more slowly, and the camera
resolves little below it."""

RIM_POINTS = 120
"""Most points of an outline."""

MARGIN_PX, LARGEST_PX = 6, 640
"""Margin around the object in a rendered view, and largest length of its longer side, pixels: an object that
needs more is too near."""


@dataclass(frozen=True, eq=False)
class RenderedView:
    """arrays: the model with pixels as its visible samples, and detail and blunt colours in place of the two
    scales; rim_points, rim_inward (N, 3): the outline (see `outline.Rim`)."""

    arrays: ModelArrays
    rim_points: Float64
    rim_inward: Float64


def detail_colors(color: UInt8, weight: Float32) -> Float32:
    """Detail and blunt colours (2, h, w, 3) of an image (h, w, 3); pixels count by their weight (h, w), over
    0."""
    colors = smoothed_opponents(color, weight, (SHARP_PX, BLUNT_PX))
    colors[0] -= colors[1]
    return colors


def render_view(
    model: ReferenceModel, T_cam_obj: Float, camera: Camera, samples: int, light: Light | None = None
) -> RenderedView | None:
    """The rendered view of a pose (4, 4) with at most `samples` samples, in a light if one is given; None if
    it shows too little of the object, or if the object is too near to be rendered."""
    window = _window(model, T_cam_obj, camera)
    if window is None:
        return None
    T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
    seen = render([(model.mesh, T)], window)
    shown = seen.depth > 0
    rows, columns = _random_pixels(shown, samples)
    rim_rows, rim_columns, inward_px = _rim(shown)
    if len(rows) < 20 or not len(rim_rows):
        return None
    picked = rendered_colors(seen, T, light)[:, rows, columns]
    R = T[:3, :3]
    metres = seen.depth[rim_rows, rim_columns][:, None] / np.array([window.fx, window.fy])
    inward = np.zeros((len(rim_rows), 3))
    inward[:, :2] = inward_px * metres
    base = model_arrays(model)
    first, count = len(base.points), len(rows)
    # Appended to the samples of the surface, because the distance grid refers to these.
    arrays = base._replace(
        points=_joined(base.points, seen.points_at(rows, columns)),
        normals=_joined(base.normals, seen.normals_at(rows, columns) @ R),
        colors=np.stack([_joined(base.colors[k], picked[k]) for k in range(2)]),
        directions=np.array([[0.0, 0.0, 1.0]], np.float32),
        beside=np.empty((1, 0), np.int32),
        visible=np.arange(first, first + count, dtype=np.int32),
        offsets=np.array([0, count], np.int32),
    )
    points = seen.points_at(rim_rows, rim_columns).astype(np.float64)
    return RenderedView(arrays, np.ascontiguousarray(points), inward @ R)


def _window(model: ReferenceModel, T_cam_obj: Float, camera: Camera) -> Camera | None:
    """The camera of the window around a pose, which may reach beyond the image; None where it is too near."""
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


def rendered_colors(picture: Rendering, T_cam_obj: Float64, light: Light | None) -> Float32:
    """Detail and blunt colours of a rendered pose (4, 4) in a light; the light does not change the lightness,
    which shading changes most."""
    shown = picture.depth > 0
    weight = np.maximum(shown, np.float32(1e-6))
    colors = detail_colors(picture.color, weight)
    if light is not None:
        lit = light.falls_on_picture(picture.color, picture.normals_cam, T_cam_obj[:3, :3])
        colors[..., 1:] = detail_colors(lit, weight)[..., 1:]
    return colors
