"""Renders a random textured object that moves through six frames of a camera at 30 Hz, with exact poses.

The scene has what the tracker meets: a ground with other things on it, an occluder, light of any strength
that may change from frame to frame, motion blur and sensor noise, and depth that is exact or as an active
stereo camera measures it. Only the window that the tracker uses is rendered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from huepose.geometry import Camera, Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Bool, Float32, Float64, Rng
from huepose.geometry.box import Box
from huepose.rendering.render import Rendering, render
from huepose.scenes.camera import COLOR, RATE_HZ, STEREO
from huepose.scenes.carried import random_strong_light
from huepose.scenes.frame import SHUTTER
from huepose.scenes.light import Light, shine
from huepose.scenes.room import clutter, sheet, table_top, wallpaper
from huepose.scenes.sensor import expose, stereo_depth
from huepose.training.shapes import random_object, random_rotation

FRAMES = 6
OTHERS = 3
"""Number of things on the ground."""

MARGIN_PX = 12
"""Margin around the object's box, for motion while the shutter is open."""

NO_SHADOW = np.zeros((4, 4), np.float32), np.eye(4)


@dataclass(frozen=True)
class ViewRange:
    """Ranges of sizes, distances and speeds; the speeds reach those of the protocol that the paper uses, and
    beyond. Shares of the sequences: with an occluder, with changing light, with depth of a stereo camera."""

    diameter_m: tuple[float, float] = (0.1, 0.3)
    distance_m: tuple[float, float] = (0.4, 0.9)
    turn_rad_s: tuple[float, float] = (0.0, 7.0)
    speed_m_s: tuple[float, float] = (0.0, 0.8)
    occluded: float = 0.35
    flicker: float = 0.25
    stereo: float = 0.5


@dataclass(frozen=True, eq=False)
class Views:
    """frames: windows of a camera's frames; masks (F, H, W): where the object is visible; boxes: of its whole
    outline, in pixels of the window; T_cam_obj (F, 4, 4)."""

    frames: list[RgbdFrame]
    masks: list[Bool]
    boxes: list[Box]
    T_cam_obj: Float64


@dataclass(eq=False)
class Props:
    """Meshes of grounds and things that are made once and used often; each is sometimes replaced."""

    rng: Rng
    grounds: list[Mesh] = field(default_factory=list)
    things: list[Mesh] = field(default_factory=list)

    def ground(self) -> Mesh:
        """A table, a wall or a plain sheet."""
        return self._one(self.grounds, 8, self._new_ground)

    def thing(self) -> Mesh:
        """Clutter, or an object like the tracked ones."""
        return self._one(self.things, 24, self._new_thing)

    def _one(self, kept: list[Mesh], most: int, new: Callable[[], Mesh]) -> Mesh:
        if len(kept) < most:
            kept.append(new())
            return kept[-1]
        k = int(self.rng.integers(most))
        if self.rng.random() < 0.05:
            kept[k] = new()
        return kept[k]

    def _new_ground(self) -> Mesh:
        kind = self.rng.random()
        texture = np.full((8, 8, 3), self.rng.integers(40, 256, 3), np.uint8)
        if kind < 0.7:
            texture = table_top(self.rng, (600, 780)) if kind < 0.35 else wallpaper(self.rng, (480, 800))
        return sheet(2.6, 2.2, np.ascontiguousarray(texture))

    def _new_thing(self) -> Mesh:
        if self.rng.random() < 0.5:
            return clutter(self.rng)
        return random_object(self.rng, self.rng.uniform(0.06, 0.25))


def draw_views(rng: Rng, mesh: Mesh, props: Props, growth: float, ranges: ViewRange) -> Views:
    """Render the moving object. growth: of the window on each side of the object's box, in box sizes."""
    focal = rng.uniform(450.0, 700.0)
    camera = Camera(focal, focal, 319.5, 239.5, 640, 480)
    at = _carried(rng, camera, ranges)
    T_cam_obj = np.array([at(i) for i in range(FRAMES)])
    boxes = [Box.of_pixels(camera.project(se3.apply(T, mesh.vertices))) for T in T_cam_obj]
    rows, columns = Box.around(*(box.grown(growth) for box in boxes)).slices(camera.width, camera.height)
    window = camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    surroundings = _surroundings(rng, props, camera, T_cam_obj[FRAMES // 2][:3, 3], ranges)
    static = _Static.rendered(surroundings, window, random_strong_light(rng))
    gains = np.exp(rng.normal(0.0, 0.05, FRAMES)) if rng.random() < ranges.flicker else np.ones(FRAMES)
    stereo = rng.random() < ranges.stereo
    # Half of the sequences have no motion blur.
    instants = (-SHUTTER / 4, SHUTTER / 4) if rng.random() < 0.5 else (0.0,)
    in_window = [box._replace(x=box.x - columns.start, y=box.y - rows.start) for box in boxes]
    frames, masks = [], []
    for i, (T, box) in enumerate(zip(T_cam_obj, in_window, strict=True)):
        lit = np.mean([static.light_with(mesh, at(i + part), box) for part in instants], 0)
        color = expose(np.float32(gains[i]) * lit, COLOR, rng)
        depth, normals, mask = static.depth_with(mesh, T, box)
        if stereo:
            depth = stereo_depth(depth, normals, window, STEREO, rng)
        frames.append(RgbdFrame(color, depth, window, i, round(i * 1e9 / RATE_HZ)))
        masks.append(mask)
    return Views(frames, masks, in_window, T_cam_obj)


@dataclass(frozen=True, eq=False)
class _Static:
    """The static scene, rendered once: linear light (H, W, 3), depth (H, W) and normals (H, W, 3)."""

    camera: Camera
    light: Light
    shone: Float32
    depth: Float32
    normals: Float32

    @staticmethod
    def rendered(meshes: list[tuple[Mesh, Float64]], camera: Camera, light: Light) -> _Static:
        """Render meshes at their poses T_cam_obj (4, 4)."""
        scene = render(meshes, camera)
        return _Static(camera, light, shone(scene, camera, light, 0), scene.depth, scene.normals_cam)

    def light_with(self, mesh: Mesh, T_cam_obj: Float64, box: Box) -> Float32:
        """The linear light (H, W, 3) of the scene with the object, without cast shadows."""
        window, part, alone = self._alone(mesh, T_cam_obj, box, color=True)
        out = self.shone.copy()
        visible = _nearer(alone.depth, self.depth[window])
        out[window][visible] = shone(alone, part, self.light, 1)[visible]
        return out

    def depth_with(self, mesh: Mesh, T_cam_obj: Float64, box: Box) -> tuple[Float32, Float32, Bool]:
        """Depth and normals of the scene with the object, and the object's visible pixels (H, W)."""
        window, _, alone = self._alone(mesh, T_cam_obj, box, color=False)
        depth, normals, mask = self.depth.copy(), self.normals.copy(), np.zeros(self.depth.shape, bool)
        visible = _nearer(alone.depth, depth[window])
        depth[window][visible], normals[window][visible] = alone.depth[visible], alone.normals_cam[visible]
        mask[window] = visible
        return depth, normals, mask

    def _alone(
        self, mesh: Mesh, T_cam_obj: Float64, box: Box, color: bool
    ) -> tuple[tuple[slice, slice], Camera, Rendering]:
        rows, columns = box.grown(0.0, MARGIN_PX).slices(self.camera.width, self.camera.height)
        size = (max(columns.stop - columns.start, 0), max(rows.stop - rows.start, 0))
        part = self.camera.cropped(columns.start, rows.start, *size)
        return (rows, columns), part, render([(mesh, T_cam_obj)], part, color=color)


def _nearer(depth: Float32, other: Float32) -> Bool:
    return np.asarray((depth > 0) & ((other == 0) | (depth < other)))


def shone(seen: Rendering, camera: Camera, light: Light, glossy: int) -> Float32:
    """The linear light (H, W, 3) of a rendering, without cast shadows; glossy: 1 for glossy surfaces."""
    total: Float32 = np.zeros((camera.height, camera.width, 3), np.float32)
    gloss = np.full(seen.depth.shape, glossy, np.uint8)
    args = (seen.color, seen.normals_cam, seen.depth, gloss, camera, np.eye(4), light, NO_SHADOW)
    shine(*args, total)
    return total


def _carried(rng: Rng, camera: Camera, ranges: ViewRange) -> Callable[[float], Float64]:
    """The pose T_cam_obj (4, 4) at any time in frames: as moved by a hand, with slowly changing velocity."""
    position = camera.backproject(
        rng.uniform([90.0, 90.0], [camera.width - 90.0, camera.height - 90.0])[None],
        np.array([rng.uniform(*ranges.distance_m)]),
    )[0]
    R = random_rotation(rng)
    turn = rng.uniform(*ranges.turn_rad_s) * random_unit(rng) / RATE_HZ
    shift = rng.uniform(*ranges.speed_m_s) * random_unit(rng) / RATE_HZ
    turn_change, shift_change = (0.5 * rng.normal(0.0, 0.1, 3) * np.linalg.norm(x) for x in (turn, shift))
    middle = (FRAMES - 1) / 2

    def at(when: float) -> Float64:
        t = when - middle
        R_at = se3.rotation_exp(turn * t + turn_change * t**2) @ R
        return se3.make(R_at, position + shift * t + shift_change * t**2)

    return at


def random_unit(rng: Rng) -> Float64:
    """A uniformly distributed direction (3,)."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _surroundings(
    rng: Rng, props: Props, camera: Camera, centre: Float64, ranges: ViewRange
) -> list[tuple[Mesh, Float64]]:
    """Meshes and poses: the ground behind the object at `centre` (3,), things on it, perhaps an occluder."""
    ground_m = float(centre[2]) + rng.uniform(0.15, 0.6)
    tilt = np.array([np.pi + rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4), 0.0])
    out = [(props.ground(), se3.make(se3.rotation_exp(tilt), np.array([0.0, 0.0, ground_m])))]
    pixel = camera.project(centre)
    depths_m = OTHERS * [ground_m - 0.05]
    if rng.random() < ranges.occluded:
        depths_m.append(rng.uniform(0.65, 0.85) * float(centre[2]))
    return out + [(props.thing(), _somewhere(rng, camera, pixel, z)) for z in depths_m]


def _somewhere(rng: Rng, camera: Camera, pixel: Float64, depth_m: float) -> Float64:
    """A pose near a pixel (2,), at a depth."""
    point = camera.backproject((pixel + rng.normal(0.0, 90.0, 2))[None], np.array([depth_m]))[0]
    return se3.make(random_rotation(rng), point)
