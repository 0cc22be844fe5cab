"""Renders training samples for the view codes: random objects in windows of scenes, and clean views.

A scene has what the detector meets: an object on a ground among other things, partly occluded, in any light,
with blur and sensor noise, and depth of a stereo camera, of a time-of-flight camera, or exact. A window is
rendered twice as wide as the network's input, so that training can shift and enlarge it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Bool, Float32, Float64, Rng, UInt8
from huepose.propose.templates import SPAN
from huepose.propose.view_images import SIDE, Pyramid, clean_view, upright_views, window_images
from huepose.propose.views import onto_rays
from huepose.rendering.render import Rendering, render
from huepose.scenes.camera import COLOR, STEREO
from huepose.scenes.carried import random_strong_light
from huepose.scenes.sensor import expose, lost_in_bad_light, stereo_depth
from huepose.training.shapes import random_object, random_rotation
from huepose.training.views import Props, random_unit, shone

WIDE = 2
"""Width of a rendered window, in widths of the network's input."""

WINDOWS = 10
"""Windows of each object."""

TRIES = 3
"""Largest number of windows rendered for each one that is kept; windows that show too little of the object
are rejected."""

WIDTH, HEIGHT = 640, 480
"""Size of the camera's whole image, pixels."""

DIAMETER_M, DISTANCE_M, FOCAL_PX = (0.06, 0.35), (0.4, 1.0), (450.0, 950.0)
"""Bounds of the objects' diameters and distances, and of the focal length."""

FAR, FAR_M = 0.4, (0.7, 1.9)
"""Share of the windows with other bounds of the distance, and these."""

ON_GROUND, WALL, IN_FRONT, PILED, BLURRED = 0.8, 0.4, 0.35, 0.4, 0.3
"""Shares of the windows: with a ground, with a wall, with an occluder, with things all around the object as
in a pile, with motion blur."""

STEREO_SHARE, FLIGHT_SHARE = 0.65, 0.2
"""Shares of the windows with depth of a stereo and of a time-of-flight camera; the others' depth is exact."""

SHOWN = 0.25
"""Least visible share of the object."""

TURNED_DEG = 5.0
"""Standard deviation of the rotation error, about each axis, of a pose that is nearly right."""


class Drawn(NamedTuple):
    """One object. view_colors (V, 92, 92, 3) uint8 and view_reliefs (V, 92, 92) float16: its clean views
    without a roll; colors (Q, 128, 128, 3) uint8 and reliefs (Q, 128, 128) float16: windows around it, twice
    as wide as the network's input; rotations (Q, 3, 3) float32: its rotations in them, relative to the
    window's ray; shown (Q, 128, 128): where it is visible; pose_colors (Q, 64, 64, 3) uint8 and pose_reliefs
    (Q, 64, 64) float16: its clean views in nearly these rotations."""

    view_colors: UInt8
    view_reliefs: np.ndarray
    colors: UInt8
    reliefs: np.ndarray
    rotations: Float32
    shown: Bool
    pose_colors: UInt8
    pose_reliefs: np.ndarray


def endless(seed: int, stream: int) -> Iterator[Drawn]:
    """Random objects without end; the same seed and stream give the same ones."""
    rng = np.random.default_rng([seed, stream])
    props = Props(rng)
    while True:
        drawn = draw_object(rng, props)
        if drawn is not None:
            yield drawn


def draw_object(rng: Rng, props: Props) -> Drawn | None:
    """One random object with its windows and views; None if too few windows show it."""
    low, high = np.log(DIAMETER_M)
    mesh = random_object(rng, float(np.exp(rng.uniform(low, high))))
    some = mesh.vertices[rng.integers(len(mesh.vertices), size=300)]
    diameter_m = float(np.linalg.norm(some[:, None] - some[None], axis=-1).max())
    windows = []
    for _ in range(TRIES * WINDOWS):
        window = _window(rng, mesh, diameter_m, props)
        if window is not None:
            windows.append(window)
        if len(windows) == WINDOWS:
            break
    else:
        return None
    colors, reliefs = upright_views(mesh, diameter_m)
    return Drawn(colors, reliefs.astype(np.float16), *(np.stack(part) for part in zip(*windows, strict=True)))


def _window(
    rng: Rng, mesh: Mesh, diameter_m: float, props: Props
) -> tuple[UInt8, np.ndarray, Float32, Bool, UInt8, np.ndarray] | None:
    """The parts of `Drawn` for one window; None if too little of the object is visible."""
    focal = rng.uniform(*FOCAL_PX)
    whole = Camera(focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, WIDTH, HEIGHT)
    z = rng.uniform(*(FAR_M if rng.random() < FAR else DISTANCE_M))
    pixel = rng.uniform([40.0, 40.0], [WIDTH - 40.0, HEIGHT - 40.0])
    centre = whole.backproject(pixel[None], np.array([z]))[0]
    R = random_rotation(rng)
    T = se3.make(R, centre - R @ mesh.centre)
    half = int(0.525 * WIDE * SPAN * diameter_m / z * focal) + 2
    left, top = int(pixel[0]) - half, int(pixel[1]) - half
    camera = whole.cropped(left, top, 2 * half, 2 * half)
    alone = render([(mesh, T)], camera, color=False).depth
    inside = np.zeros(alone.shape, bool)
    inside[max(0, -top) : HEIGHT - top, max(0, -left) : WIDTH - left] = True
    seen = render([(mesh, T), *_surroundings(rng, mesh, T, centre, diameter_m, props)], camera)
    own = (alone > 0) & (np.abs(seen.depth - alone) < 1e-4) & inside
    if own.sum() < max(60, SHOWN * (alone > 0).sum()):
        return None
    color = _color(rng, seen, camera)
    depth = np.where(inside, _depth(rng, seen, color, camera), np.float32(0.0))
    rows, columns = np.nonzero(alone)
    middle, median = np.array([columns.mean(), rows.mean()]), float(np.median(alone[rows, columns]))
    span_px = SPAN * diameter_m / median * focal
    place = middle[None], np.array([median]), np.array([span_px])
    shown = np.where(inside[..., None], color, 0).astype(np.uint8)
    picture = Pyramid(shown)
    colors, reliefs = window_images(picture, depth, *place, diameter_m, wide=WIDE)
    _, owns = window_images(picture, np.where(own, alone, np.float32(0.0)), *place, diameter_m, wide=WIDE)
    R_ray = onto_rays(camera.rays(middle[None]))[0]
    along_ray = R_ray.T @ R
    near = cv2.Rodrigues(np.radians(TURNED_DEG) * rng.normal(size=3))[0] @ along_ray
    posed = clean_view(mesh, diameter_m, near)
    return (
        *(colors[0], _half(reliefs[0]), along_ray.astype(np.float32), np.isfinite(owns[0])),
        *(posed.color, posed.relief.astype(np.float16)),
    )


def _half(relief: Float32) -> np.ndarray:
    return np.clip(relief, -8.0, 8.0).astype(np.float16)


def _surroundings(
    rng: Rng, mesh: Mesh, T: Float64, centre: Float64, diameter_m: float, props: Props
) -> list[tuple[Mesh, Float64]]:
    """Meshes and poses around the object: the ground below it, a wall, other things, an occluder."""
    out: list[tuple[Mesh, Float64]] = []
    towards = -centre / np.linalg.norm(centre)
    up, foot = None, centre
    if rng.random() < ON_GROUND:
        up = random_unit(rng)
        while up @ towards < 0.2:
            up = random_unit(rng)
        low = float((se3.apply(T, mesh.vertices) @ up).min())
        foot = centre + up * (low - centre @ up - abs(rng.normal(0.0, 0.002)))
        out.append((props.ground(), _lying(rng, up, foot)))
    if up is None or rng.random() < WALL:
        behind = rng.uniform(0.5, 3.0) * diameter_m + rng.uniform(0.0, 1.5) * (rng.random() < 0.4)
        facing = towards + 0.5 * rng.normal(size=3)
        at = centre - behind * towards
        out.append((props.ground(), _lying(rng, facing / np.linalg.norm(facing), at)))
    for _ in range(int(rng.integers(0, 5))):
        thing, turn = props.thing(), random_rotation(rng)
        if up is None:
            at = centre + random_unit(rng) * rng.uniform(0.5, 1.2) * diameter_m
        else:
            side = np.cross(up, random_unit(rng))
            at = foot + side / np.linalg.norm(side) * (rng.uniform(0.3, 1.1) * diameter_m + 0.03)
            at = at - up * float((thing.vertices @ turn.T @ up).min())
        out.append((thing, se3.make(turn, at)))
    if rng.random() < PILED:
        for _ in range(int(rng.integers(4, 10))):
            at = centre + random_unit(rng) * rng.uniform(0.4, 0.9) * diameter_m
            out.append((props.thing(), se3.make(random_rotation(rng), at)))
    if rng.random() < IN_FRONT:
        aside = np.array([*(rng.normal(0.0, 0.5, 2) * diameter_m), 0.0])
        out.append((props.thing(), se3.make(random_rotation(rng), centre * rng.uniform(0.7, 0.9) + aside)))
    return out


def _color(rng: Rng, seen: Rendering, camera: Camera) -> UInt8:
    """The camera's image (H, W, 3) of a rendering, in a random light, exposure and motion blur."""
    light = random_strong_light(rng)
    linear = shone(seen, camera, light, int(rng.random() < 0.6))
    if rng.random() < BLURRED:
        linear = np.asarray(cv2.filter2D(linear, -1, _motion(rng)), np.float32)
    return expose(np.float32(2.0 ** rng.normal(0.0, 0.25)) * linear, COLOR, rng)


def _motion(rng: Rng) -> Float32:
    """The kernel (15, 15) of a straight motion of 3 to 9 pixels in a random direction."""
    kernel = np.zeros((15, 15), np.float32)
    reach = int(rng.integers(1, 5))
    kernel[7, 7 - reach : 8 + reach] = 1.0
    turn = cv2.getRotationMatrix2D((7.0, 7.0), float(rng.uniform(0.0, 180.0)), 1.0)
    kernel = np.asarray(cv2.warpAffine(kernel, turn, (15, 15)), np.float32)
    return np.asarray(kernel / kernel.sum(), np.float32)


def _depth(rng: Rng, seen: Rendering, color: UInt8, camera: Camera) -> Float32:
    """The depth (H, W) that a random kind of depth camera measures, metres; 0 without a reading."""
    which = rng.random()
    if which < STEREO_SHARE:
        sensor = replace(STEREO, subpixel=rng.uniform(0.04, 0.15))
        depth = stereo_depth(seen.depth, seen.normals_cam, camera, sensor, rng)
        return lost_in_bad_light(depth, color, rng) if rng.random() < 0.3 else depth
    if which < STEREO_SHARE + FLIGHT_SHARE:
        noise = rng.normal(0.0, 0.0015, seen.depth.shape) * (seen.depth > 0)
        depth = (seen.depth + noise).astype(np.float32)
        return np.where(_edges(rng, seen.depth), np.float32(0.0), depth) if rng.random() < 0.8 else depth
    return seen.depth


def _edges(rng: Rng, depth: Float32) -> Bool:
    """Pixels beside depth steps, where a time-of-flight camera mixes both sides and gives no reading."""
    wide = int(rng.integers(3, 8))
    steps = cv2.morphologyEx(depth, cv2.MORPH_GRADIENT, np.ones((wide, wide), np.uint8))
    return np.asarray(steps > 0.03)


def _lying(rng: Rng, up: Float64, at: Float64) -> Float64:
    """The pose (4, 4) of a sheet at a point (3,) with normal `up` (3,) and a random rotation about it."""
    x = np.cross(up, random_unit(rng))
    x /= np.linalg.norm(x)
    return se3.make(np.column_stack([x, np.cross(up, x), up]), at)


PIXELS = WIDE * SIDE
"""Side of a rendered window, pixels."""
