"""Labelled pictures of objects for a detector, endlessly: thrown together by code, cheap rather than true.

Objects and other things float before a backdrop in any turn and hide each other; light, tint, shadow, blur
and noise vary. All of it follows from the seed. Pictures are made at the size of the network's input, with
the letterbox that the detector uses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from huepose.geometry import Box, Camera, Mesh, se3
from huepose.geometry.arrays import Float32, Float64, UInt8
from huepose.perception.letterbox import Letterbox
from huepose.rendering.render import Rendering, render
from huepose.scenes.frame import silhouette_px
from huepose.scenes.light import Light, shine
from huepose.scenes.room import clutter
from huepose.scenes.sensor import ColorSensor, expose
from huepose.training.backdrops import Backdrops
from huepose.training.shapes import random_rotation

Rng = np.random.Generator

IMAGE_SIZE = (480, 640)
"""Height and width of the cameras' pictures, which the letterbox brings into the input."""

_NO_SHADOW = (np.zeros((4, 4), np.float32), np.eye(4))
_OTHERS_KEPT = 16


@dataclass(frozen=True)
class PictureRange:
    """From what range each thing is drawn. objects, others: counts in a picture; distance_m, focal_px (at 640
    x 480): of the camera; together_m: radius of the space where things lie close, in half of the pictures;
    exposure: in stops; tint: natural logarithm of red and blue against green; key, sky, gloss: of
    `synthetic_light.Light`; blur_px: motion in pixels of the input, in a third of the pictures; empty: share
    of pictures without an object; least_visible: an object is labelled from this visible share on."""

    objects: tuple[int, int] = (2, 7)
    others: tuple[int, int] = (0, 6)
    distance_m: tuple[float, float] = (0.45, 1.3)
    focal_px: tuple[float, float] = (540.0, 680.0)
    together_m: tuple[float, float] = (0.08, 0.25)
    exposure: tuple[float, float] = (-1.3, 0.8)
    tint: tuple[float, float] = (-0.3, 0.3)
    key: tuple[float, float] = (0.25, 1.0)
    sky: tuple[float, float] = (0.15, 0.5)
    gloss: tuple[float, float] = (0.0, 0.35)
    blur_px: tuple[float, float] = (1.0, 5.0)
    empty: float = 0.05
    least_visible: float = 0.15


@dataclass(frozen=True, eq=False)
class LabelledPicture:
    """image (H, W, 3) uint8 RGB of the input's size; corners (K, 4) x0 y0 x1 y1 in its pixels of what is seen
    of each object; classes (K,)."""

    image: UInt8
    corners: Float32
    classes: np.ndarray


@dataclass
class PictureMaker:
    """Draws pictures of `things`: by class the meshes that mean it, all equally likely."""

    things: Mapping[str, Sequence[Mesh]]
    input_size: tuple[int, int]
    rng: Rng
    ranges: PictureRange = field(default_factory=PictureRange)

    def __post_init__(self) -> None:
        self._letterbox = Letterbox.of(IMAGE_SIZE, self.input_size, centered=True)
        self._backdrops = Backdrops(self.rng)
        self._others: list[Mesh] = []
        self._choices = [(k, m) for k, meshes in enumerate(self.things.values()) for m in meshes]

    def draw(self) -> LabelledPicture:
        """One more picture."""
        rng, ranges = self.rng, self.ranges
        camera = self._camera()
        count = (
            0 if rng.random() < ranges.empty else int(rng.integers(ranges.objects[0], ranges.objects[1] + 1))
        )
        chosen = [self._choices[int(k)] for k in rng.integers(len(self._choices), size=count)]
        others = [self._other() for _ in range(int(rng.integers(ranges.others[0], ranges.others[1] + 1)))]
        meshes = [*(mesh for _, mesh in chosen), *others]
        scene = list(zip(meshes, _placed(meshes, camera, ranges, rng), strict=True))
        seen = render(scene, camera, normals=True)
        light = self._shaded(seen, camera, count)
        corners, classes = [], []
        for k, ((label, mesh), (_, T)) in enumerate(zip(chosen, scene[:count], strict=True)):
            mask = seen.object_index == k
            box = Box.of_mask(mask)
            if box is None or mask.sum() < ranges.least_visible * silhouette_px(mesh, T, camera):
                continue
            corners.append([box.x, box.y, box.x1, box.y1])
            classes.append(label)
        boxes = np.array(corners, np.float32).reshape(-1, 4)
        boxes += np.array([self._letterbox.left, self._letterbox.top] * 2, np.float32)
        image = _developed(light, ranges, rng)
        out = self._letterbox.filled(image, self.input_size)
        return LabelledPicture(out, boxes, np.array(classes, np.int64))

    def _camera(self) -> Camera:
        """Of the size that the letterbox leaves to the picture."""
        height, width = (round(side * self._letterbox.scale) for side in IMAGE_SIZE)
        focal = self._letterbox.scale * self.rng.uniform(*self.ranges.focal_px)
        return Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)

    def _other(self) -> Mesh:
        """Something that is none of the objects: mostly one that was made before."""
        if len(self._others) < _OTHERS_KEPT or self.rng.random() < 0.1:
            self._others = [*self._others[-_OTHERS_KEPT + 1 :], clutter(self.rng)]
        return self._others[int(self.rng.integers(len(self._others)))]

    def _shaded(self, seen: Rendering, camera: Camera, count: int) -> Float32:
        """Linear light (H, W, 3) of what is seen, the backdrop where there is nothing."""
        rng = self.rng
        behind = self._backdrops.draw(camera)
        nothing = seen.object_index < 0
        color = np.where(nothing[..., None], behind.color, seen.color)
        normals = np.where(nothing[..., None], behind.normals_cam, seen.normals_cam)
        depth = np.where(nothing, behind.depth, seen.depth)
        glossy = (~nothing & (seen.object_index < count)).astype(np.uint8)
        tilt = se3.make(se3.rotation_exp(rng.normal(0.0, 0.4, 3)), np.zeros(3))
        total = np.zeros(color.shape, np.float32)
        shine(color, normals, depth, glossy, camera, tilt, _light(self.ranges, rng), _NO_SHADOW, total)
        return total * _blotches(rng, depth.shape)[..., None]


def endless_pictures(
    things: Mapping[str, Sequence[Mesh]],
    input_size: tuple[int, int],
    seed: int,
    stream: int,
    ranges: PictureRange | None = None,
) -> Iterator[LabelledPicture]:
    """Pictures without end, of an input (height, width); the same seed and stream give the same ones."""
    rng = np.random.default_rng([seed, stream])
    maker = PictureMaker(things, input_size, rng, ranges or PictureRange())
    while True:
        yield maker.draw()


def _placed(meshes: Sequence[Mesh], camera: Camera, ranges: PictureRange, rng: Rng) -> list[Float64]:
    """Poses T_cam_mesh (4, 4) all over the picture, or together in one place; none inside another."""
    middle = _anywhere(camera, ranges, rng)
    near = rng.uniform(*ranges.together_m) if rng.random() < 0.5 else None
    poses: list[Float64] = []
    taken: list[tuple[Float64, float]] = []
    for mesh in meshes:
        radius = 0.5 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        for _ in range(8):
            at = _anywhere(camera, ranges, rng) if near is None else middle + rng.normal(0.0, near, 3)
            at[2] = max(at[2], 0.8 * ranges.distance_m[0])
            if all(np.linalg.norm(at - other) > 0.6 * (radius + size) for other, size in taken):
                break
        R = random_rotation(rng)
        poses.append(se3.make(R, at - R @ mesh.centre))
        taken.append((at, radius))
    return poses


def _anywhere(camera: Camera, ranges: PictureRange, rng: Rng) -> Float64:
    """A point (3,) in view."""
    pixel = rng.uniform([0.0, 0.0], [camera.width, camera.height])
    return np.asarray(camera.backproject(pixel[None], np.array([rng.uniform(*ranges.distance_m)]))[0])


def _light(ranges: PictureRange, rng: Rng) -> Light:
    x, y = rng.normal(0.0, 0.6, 2)
    towards = np.array([x, y - 0.6, -1.0])
    tint = np.exp([rng.uniform(*ranges.tint), 0.0, rng.uniform(*ranges.tint)])
    return Light(
        towards / np.linalg.norm(towards),
        rng.uniform(*ranges.key),
        rng.uniform(*ranges.sky),
        np.asarray(2.0 ** rng.uniform(*ranges.exposure) * tint),
        rng.uniform(*ranges.gloss),
    )


def _blotches(rng: Rng, shape: tuple[int, ...]) -> Float32:
    """Shadows (H, W) of nothing in particular, in half of the pictures."""
    if rng.random() < 0.5:
        return np.ones(shape, np.float32)
    rough = rng.normal(0.0, 1.0, (5, 6)).astype(np.float32)
    smooth = cv2.resize(rough, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    edge = rng.uniform(2.0, 20.0)
    share = 1.0 / (1.0 + np.exp(-edge * (smooth - rng.uniform(-0.5, 0.5))))
    return np.asarray(1.0 - rng.uniform(0.2, 0.75) * share, np.float32)


def _developed(light: Float32, ranges: PictureRange, rng: Rng) -> UInt8:
    """The camera's picture (H, W, 3): motion blur now and then, lens, noise."""
    if rng.random() < 1 / 3:
        streak = _streak(rng.uniform(*ranges.blur_px), rng.uniform(0, np.pi))
        light = cv2.filter2D(light, -1, streak).astype(np.float32, copy=False)
    # A picture that is made smaller has its noise averaged.
    sensor = ColorSensor(6000.0 * rng.uniform(0.3, 4.0), blur_px=rng.uniform(0.25, 0.8))
    return expose(light, sensor, rng)


def _streak(length_px: float, angle: float) -> Float32:
    """The kernel of a motion in a line."""
    side = 2 * int(np.ceil(length_px / 2)) + 1
    kernel = np.zeros((side, side), np.float32)
    reach = 0.5 * length_px * np.array([np.cos(angle), np.sin(angle)])
    for part in np.linspace(-1.0, 1.0, 8 * side):
        column, row = np.rint(side // 2 + part * reach).astype(int)
        kernel[row, column] += 1.0
    return kernel / kernel.sum()
