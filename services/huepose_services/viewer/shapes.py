"""The arrays that the viewer draws: outlines and axes in the image, the point cloud, meshes. It does not
use rerun."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry import Camera, se3
from huepose.geometry.arrays import Bool, Float, Float32, UInt8, UInt16
from huepose.geometry.mesh import Mesh
from huepose.model import ReferenceModel
from huepose.rendering.render import render_depth

_MAX_TEXTURE = 512
_CLOUD_REACH_M = 3.0
_PIXELS_TOLERANCE = 0.7
_LABEL_ADVANCE, _LABEL_ROW, _LABEL_MARGIN = 7.0, 16.0, 8.0


def outlines(mesh: Mesh, T_cam_obj: Float, camera: Camera) -> list[Float32]:
    """Closed border lines (N, 2) of the pixels that a mesh covers at a pose; none if it is outside the
    image."""
    depth = render_depth(mesh, T_cam_obj, camera)
    covered: UInt8 = (depth > 0).astype(np.uint8)
    found, _ = cv2.findContours(covered, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    lines = []
    for contour in found:
        line = cv2.approxPolyDP(contour, _PIXELS_TOLERANCE, True)[:, 0].astype(np.float32)
        if len(line) >= 3:
            lines.append(np.concatenate([line, line[:1]]))
    return lines


def warm_up() -> None:
    """Compute one outline, so that the kernels are compiled before the first image."""
    corners = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.1, 0.0]], np.float32)
    texture = np.zeros((1, 1, 3), np.uint8)
    triangle = Mesh(corners, np.array([[0, 1, 2]], np.int32), np.zeros((1, 3, 2), np.float32), texture)
    far = se3.make(np.eye(3), np.array([0.0, 0.0, 1.0]))
    outlines(triangle, far, Camera(300.0, 300.0, 159.5, 119.5, 320, 240))


def axes(T_cam_obj: Float, camera: Camera, length_m: float, centre_obj: Float) -> list[Float32] | None:
    """The x, y and z axis (2, 2) of an object in the image, from its centre; None if a point is behind the
    camera."""
    points = centre_obj + np.vstack([np.zeros(3), length_m * np.eye(3)])
    pixels = camera.project(se3.apply(T_cam_obj, points)).astype(np.float32)
    if not np.isfinite(pixels).all():
        return None
    return [pixels[[0, i]] for i in (1, 2, 3)]


def cloud(
    color: UInt8, depth: UInt16, depth_scale_m: float, camera: Camera, stride: int
) -> tuple[Float32, UInt8]:
    """Points (N, 3) in camera axes and their colours (N, 3): every stride-th pixel, if it has depth."""
    z = depth[::stride, ::stride] * depth_scale_m
    rows, columns = np.nonzero((z > 0) & (z < _CLOUD_REACH_M))
    pixels = np.stack([columns, rows], -1).astype(np.float64)
    points = camera.backproject(stride * pixels, z[rows, columns])
    return points.astype(np.float32), color[::stride, ::stride][rows, columns]


@dataclass(frozen=True, eq=False)
class Body:
    """What a viewer needs of a reference model; whole: the whole model, if its colour pairs are shown."""

    mesh: Mesh
    diameter_m: float
    whole: ReferenceModel | None = None

    @staticmethod
    def of(model: ReferenceModel, whole: bool = False) -> Body:
        """The body of a model. whole: keep the whole model, too."""
        return Body(model.mesh, model.diameter_m, model if whole else None)


def drawable(mesh: Mesh) -> dict[str, np.ndarray]:
    """A mesh for graphics cards, by rerun's names: positions (3F, 3), triangles (F, 3), texture coordinates
    (3F, 2) and a texture of at most 512 pixels a side. Each corner is a vertex of its own, because texture
    coordinates belong to corners."""
    corners = mesh.faces.reshape(-1)
    texture = mesh.texture
    scale = _MAX_TEXTURE / max(texture.shape[:2])
    if scale < 1.0:
        height, width = (max(1, round(scale * side)) for side in texture.shape[:2])
        small = cv2.resize(texture, (width, height), interpolation=cv2.INTER_AREA)
        texture = small.astype(np.uint8, copy=False)
    return {
        "vertex_positions": mesh.vertices[corners],
        "triangle_indices": np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        "vertex_texcoords": mesh.uv.reshape(-1, 2),
        "albedo_texture": texture,
    }


def yuv(color: UInt8) -> tuple[bytes, int, int]:
    """Planes Y, U and V of an image (H, W, 3), U and V at half its width and height: half the bytes; and
    width and height of Y, which are even."""
    height, width = color.shape[0] // 2 * 2, color.shape[1] // 2 * 2
    return cv2.cvtColor(color[:height, :width], cv2.COLOR_RGB2YUV_I420).tobytes(), width, height


def depth_range(depth: UInt16) -> tuple[float, float]:
    """The range of the depths of an image in its own steps, from the 1st to the 95th percentile."""
    known: Bool = depth > 0
    if not known.any():
        return 0.0, 1.0
    low, high = np.percentile(depth[known], [1.0, 95.0])
    return float(low), float(max(high, low + 1.0))


def label_size(text: str) -> tuple[float, float]:
    """The approximate width and height of a label: rerun draws labels in one size, whatever the size of the
    image."""
    rows = text.split("\n")
    return _LABEL_ADVANCE * max(map(len, rows)) + 2 * _LABEL_MARGIN, _LABEL_ROW * len(rows) + _LABEL_MARGIN


def apart(
    tips: Sequence[tuple[float, float]], sizes: Sequence[tuple[float, float]], width: int, height: int
) -> list[tuple[float, float]]:
    """Move points so that labels of these sizes below them do not overlap and stay inside the image. Each
    point moves as little as the labels before it in the list allow.

    >>> apart([(50.0, 20.0), (60.0, 25.0)], [(40.0, 10.0), (40.0, 10.0)], 200, 100)
    [(50.0, 20.0), (60.0, 30.0)]
    """
    placed: list[tuple[float, float, float, float]] = []
    for (x, y), (w, h) in zip(tips, sizes, strict=True):
        x = min(max(x, w / 2), max(width - w / 2, w / 2))
        y = min(max(y, 0.0), max(height - h, 0.0))
        near = [o for o in placed if abs(x - o[0]) < (w + o[2]) / 2]
        free = [y, *(o[1] - h for o in near), *(o[1] + o[3] for o in near)]
        free = [
            top
            for top in free
            if 0.0 <= top <= max(height - h, 0.0) and all(top >= o[1] + o[3] or top + h <= o[1] for o in near)
        ]
        placed.append((x, min(free, key=lambda top: abs(top - y), default=y), w, h))
    return [(x, y) for x, y, _, _ in placed]
