"""One exposure of the rendered camera, and the exact ground truth at its middle.

The shutter is open for a share of the frame time. Colour is the mean of several instants, each shifted by a
part of a pixel: this gives both motion blur and smooth edges. Depth and ground truth are those of the middle
instant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.geometry import Box, Camera, Mesh, se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, UInt8
from huepose.geometry.camera import NEAR_M
from huepose.rendering import render, render_depth
from huepose.scenes.camera import ColorSensor, StereoSensor
from huepose.scenes.light import Light, shadow_map, shine
from huepose.scenes.sensor import expose, stereo_depth

SHUTTER = 0.25  # of the frame time: 1/120 s at 30 Hz
# Instants of the exposure: when (in shutter times) and where in the pixel (px).
_INSTANTS = ((-1 / 3, 0.0, -1 / 3), (0.0, 1 / 3, 1 / 6), (1 / 3, -1 / 3, 1 / 6))


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene over time. meshes: the first `labelled` of them are the labelled objects; T_room_mesh
    (M, N, 4, 4) and T_cam_room (N, 4, 4): poses by mesh and frame, in a closed loop; lights: one for each
    frame; lamp: a second light, the same in all frames."""

    meshes: tuple[Mesh, ...]
    labelled: int
    T_room_mesh: Float64
    T_cam_room: Float64
    lights: tuple[Light, ...]
    camera: Camera
    lamp: Light | None = None

    def __len__(self) -> int:
        return len(self.T_cam_room)

    def poses(self, i: int, part: float = 0.0) -> tuple[list[Float64], Float64]:
        """T_room_mesh of every mesh and T_cam_room, `part` of a frame time after frame i (-0.5 to 0.5)."""
        if part == 0.0:
            return list(self.T_room_mesh[:, i]), self.T_cam_room[i]
        j = (i + (1 if part > 0 else -1)) % len(self)
        now, then = self.T_room_mesh[:, i], self.T_room_mesh[:, j]
        moved = [
            a if np.array_equal(a, b) else se3.interpolate(a, b, abs(part), mesh.centre)
            for a, b, mesh in zip(now, then, self.meshes, strict=True)
        ]
        return moved, se3.interpolate(self.T_cam_room[i], self.T_cam_room[j], abs(part))

    def in_camera(self, i: int, part: float = 0.0) -> list[tuple[Mesh, Float64]]:
        """Every mesh with T_cam_mesh."""
        moved, T_cam_room = self.poses(i, part)
        return [(mesh, T_cam_room @ T) for mesh, T in zip(self.meshes, moved, strict=True)]


@dataclass(frozen=True, eq=False)
class Labels:
    """Ground truth of the K labelled objects of a frame: T_cam_obj (K, 4, 4); visib_fract (K,); box_visib:
    bounds of the visible pixels, None where there are none."""

    T_cam_obj: Float64
    visib_fract: Float64
    box_visib: tuple[Box | None, ...]


def labels(stage: Stage, i: int, camera: Camera) -> Labels:
    """The ground truth of frame i, by rendering. A smaller `camera` than the stage's is faster and
    coarser."""
    scene = stage.in_camera(i)
    return _labels(scene[: stage.labelled], render(scene, camera, color=False).object_index, camera)


def _labels(objects: list[tuple[Mesh, Float64]], owner: np.ndarray, camera: Camera) -> Labels:
    poses, shares, boxes = [], [], []
    for k, (mesh, T_cam_obj) in enumerate(objects):
        mask = owner == k
        alone, _ = silhouette(mesh, T_cam_obj, camera)
        poses.append(se3.orthonormalised(T_cam_obj))
        shares.append(float(mask.sum()) / alone if alone else 0.0)
        boxes.append(Box.of_mask(mask))
    return Labels(np.array(poses).reshape(-1, 4, 4), np.array(shares), tuple(boxes))


def visible_mask(stage: Stage, i: int, k: int) -> Bool:
    """Pixels (H, W) of frame i in which object k is visible."""
    return np.asarray(render(stage.in_camera(i), stage.camera, color=False).object_index == k)


def silhouette(mesh: Mesh, T_cam_obj: Float, camera: Camera) -> tuple[int, Box]:
    """Pixel count and bounds of an object's outline as if nothing occluded it, parts outside the image
    included; 0 and a box of -1 if a part is too near to be rendered: the outline would be endless."""
    points_cam = se3.apply(T_cam_obj, mesh.vertices)
    if not points_cam[:, 2].min() > NEAR_M:
        return 0, Box(-1, -1, -1, -1)
    pixels = camera.project(points_cam)
    low = np.floor(pixels.min(0)).astype(int) - 1
    high = np.ceil(pixels.max(0)).astype(int) + 2
    x, y = int(low[0]), int(low[1])
    window = camera.cropped(x, y, int(high[0]) - x, int(high[1]) - y)
    seen = render_depth(mesh, T_cam_obj, window) > 0
    box = Box.of_mask(seen)
    return int(seen.sum()), Box(-1, -1, -1, -1) if box is None else Box(box.x + x, box.y + y, box.w, box.h)


@dataclass(frozen=True, eq=False)
class Shot:
    """What the camera delivers, and the ground truth. color (H, W, 3) uint8; depth (H, W) float32 m; owner
    (H, W) int16: number of the visible mesh, -1 = none."""

    color: UInt8
    depth: Float32
    labels: Labels
    owner: np.ndarray[tuple[int, ...], np.dtype[np.int16]]

    def kept(self) -> tuple[UInt8, Float32, dict[str, Any]]:
        """The frame and its truth, as they are kept in a loop file."""
        boxes = [None if box is None else list(box) for box in self.labels.box_visib]
        T_cam_obj, visib_fract = self.labels.T_cam_obj.tolist(), self.labels.visib_fract.tolist()
        truth = {"T_cam_obj": T_cam_obj, "visib_fract": visib_fract, "box_visib": boxes}
        return self.color, self.depth, truth


def shoot(
    stage: Stage, i: int, seed: int, color_sensor: ColorSensor, depth_sensor: StereoSensor | None
) -> Shot:
    """Render frame i. The same arguments give the same noise. Without a depth sensor, depth is exact."""
    rng = np.random.default_rng([seed, i, 7])
    camera = stage.camera
    moved, _ = stage.poses(i)
    placed = list(zip(stage.meshes, moved, strict=True))
    lights = [stage.lights[i]] if stage.lamp is None else [stage.lights[i], stage.lamp]
    shadows = [shadow_map(placed, light) for light in lights]
    total: Float32 = np.zeros((camera.height, camera.width, 3), np.float32)
    for when, dx, dy in _INSTANTS:
        part = when * SHUTTER
        shifted = Camera(camera.fx, camera.fy, camera.cx - dx, camera.cy - dy, camera.width, camera.height)
        seen = render(stage.in_camera(i, part), shifted)
        glossy = (seen.object_index >= 0) & (seen.object_index < stage.labelled)
        _, T_cam_room = stage.poses(i, part)
        for light, shadow in zip(lights, shadows, strict=True):
            shine(
                seen.color,
                seen.normals_cam,
                seen.depth,
                glossy.view(np.uint8),
                shifted,
                T_cam_room,
                light,
                shadow,
                total,
            )
    color = expose(total / np.float32(len(_INSTANTS)), color_sensor, rng)

    scene = stage.in_camera(i)
    middle = render(scene, camera, color=False)
    depth = middle.depth
    if depth_sensor is not None:
        depth = stereo_depth(depth, middle.normals_cam, camera, depth_sensor, rng)
    truth = _labels(scene[: stage.labelled], middle.object_index, camera)
    return Shot(color, depth, truth, middle.object_index)
