"""One moment of tracking, made by code: matched points of a random shape before and after a random motion.

A shape is rendered twice, with something in front of it. Its visible points are followed with the errors
that flow makes (a jitter, a smooth drift, matches that are simply wrong), and both ends are lifted to 3D from
noisy depth by the very function that the tracker uses. Each such turn is a question to the rotation network,
whose true answer is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Bool, Float32, Float64
from huepose.paper.rotation_network import Kind, fixed_count, posed
from huepose.propose.lifting import lift
from huepose.propose.relative_pose import LiftedMatches, RobustKabsch
from huepose.rendering.render import Rendering, render
from huepose.training.shapes import random_rotation, random_shape

CANDIDATES = 260
MIN_MATCHES = 24
SAME_SURFACE_M = 0.004
MARGIN_PX = 12


@dataclass(frozen=True)
class TurnRange:
    """What is drawn. Sizes and distances in metres, angles in radians, pixels at 640 x 480.

    Turns: half of the motions are as small as between frames at 30 Hz, half as large as every fifth frame
    shows of objects that turn 370 degrees a second.
    """

    diameter_m: tuple[float, float] = (0.06, 0.3)
    distance_m: tuple[float, float] = (0.4, 1.3)
    small_turn_rad: float = 0.25
    large_turn_rad: float = 1.1
    small_shift_m: float = 0.02
    large_shift_m: float = 0.1
    depth_noise: tuple[float, float] = (0.0, 0.004)
    """Standard deviation at one metre; it grows with the square of the distance."""
    jitter_px: tuple[float, float] = (0.05, 0.8)
    drift_px: tuple[float, float] = (0.0, 1.5)
    wrong: tuple[float, float] = (0.0, 0.35)
    """Share of wrong matches."""


@dataclass(frozen=True, eq=False)
class Turn:
    """Matches of one moment, and the true motion T_b_a (4, 4)."""

    matches: LiftedMatches
    T_b_a: Float64


def draw_turns(rng: np.random.Generator, ranges: TurnRange, draws: int = 4) -> list[Turn]:
    """One shape and one motion, seen `draws` times with other errors; empty when too little is visible."""
    focal = rng.uniform(450.0, 700.0)
    camera = Camera(focal, focal, 319.5, 239.5, 640, 480)
    shape = random_shape(rng, rng.uniform(*ranges.diameter_m))
    T_a = _placed(rng, ranges, camera)
    T_b_a = _motion(rng, ranges, T_a)
    T_b = se3.compose(T_b_a, T_a)
    hider = random_shape(rng, 0.5 * rng.uniform(*ranges.diameter_m))
    T_hider = _before(rng, T_a, shape)
    a, camera_a = _seen(shape, T_a, hider, T_hider, camera)
    moved = se3.make(np.eye(3), rng.normal(0.0, 0.02, 3))
    b, camera_b = _seen(shape, T_b, hider, se3.compose(moved, T_hider), camera)
    mask = a.object_index == 0
    if mask.sum() < MIN_MATCHES or (b.object_index == 0).sum() < MIN_MATCHES:
        return []
    turns = (_followed(rng, ranges, a, camera_a, b, camera_b, T_b, mask) for _ in range(draws))
    return [Turn(matches, T_b_a) for matches in turns if len(matches) >= MIN_MATCHES]


def _placed(rng: np.random.Generator, ranges: TurnRange, camera: Camera) -> Float64:
    """A pose T_cam_obj (4, 4) anywhere in view."""
    z = rng.uniform(*ranges.distance_m)
    pixel = rng.uniform([90.0, 90.0], [camera.width - 90.0, camera.height - 90.0])
    return se3.make(random_rotation(rng), camera.backproject(pixel[None], np.array([z]))[0])


def _motion(rng: np.random.Generator, ranges: TurnRange, T_a: Float64) -> Float64:
    """T_b_a (4, 4): a turn about the object's centre and a shift, in camera axes."""
    large = rng.random() < 0.5
    turn = rng.uniform(0.0, ranges.large_turn_rad if large else ranges.small_turn_rad)
    shift = rng.uniform(0.0, ranges.large_shift_m if large else ranges.small_shift_m)
    R = se3.rotation_exp(turn * _unit(rng))
    centre = T_a[:3, 3]
    return se3.make(R, centre - R @ centre + shift * _unit(rng))


def _before(rng: np.random.Generator, T_cam_obj: Float64, shape: Mesh) -> Float64:
    """A pose of something that stands between the camera and the object's rim."""
    size = float(np.ptp(shape.vertices, axis=0).max())
    at = T_cam_obj[:3, 3] * rng.uniform(0.7, 0.9)
    sideways = rng.normal(size=3) * [1.0, 1.0, 0.0]
    sideways /= np.linalg.norm(sideways) + 1e-9
    return se3.make(random_rotation(rng), at + sideways * size * rng.uniform(0.2, 0.8))


def _unit(rng: np.random.Generator) -> Float64:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _seen(shape: Mesh, T: Float64, hider: Mesh, T_hider: Float64, camera: Camera) -> tuple[Rendering, Camera]:
    """Depth, surface points and who is where, in the window that the shape fills."""
    pixels = camera.project(se3.apply(T, shape.vertices))
    low = np.floor(np.nan_to_num(pixels.min(0)) - MARGIN_PX).clip(0, [camera.width - 2, camera.height - 2])
    high = np.ceil(np.nan_to_num(pixels.max(0)) + MARGIN_PX).clip(low + 2, [camera.width, camera.height])
    (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
    window = camera.cropped(int(x0), int(y0), int(x1 - x0), int(y1 - y0))
    return render([(shape, T), (hider, T_hider)], window, color=False, points=True), window


def _followed(
    rng: np.random.Generator,
    ranges: TurnRange,
    a: Rendering,
    camera_a: Camera,
    b: Rendering,
    camera_b: Camera,
    T_b: Float64,
    mask: Bool,
) -> LiftedMatches:
    """Matches as a tracker would have them: noisy, some wrong, weighted by how alike they look."""
    rows, columns = np.nonzero(mask)
    chosen = rng.choice(len(rows), min(CANDIDATES, len(rows)), replace=False)
    rows, columns = rows[chosen], columns[chosen]
    pixels_a = np.stack([columns, rows], 1).astype(np.float64)
    truth = se3.apply(T_b, a.points_obj[rows, columns])
    pixels_b = camera_b.project(truth)
    hidden = ~_on_surface(b, pixels_b, truth[:, 2])
    # Flow that is checked forwards and backwards drops most of what went out of sight, not all.
    kept = ~hidden | (rng.random(len(hidden)) < 0.15)
    pixels_b = pixels_b + rng.normal(0.0, np.exp(rng.uniform(*np.log(ranges.jitter_px))), pixels_b.shape)
    pixels_b += _drift(rng, pixels_b, rng.uniform(*ranges.drift_px))
    wrong = rng.random(len(pixels_b)) < rng.uniform(*ranges.wrong)
    pixels_b[wrong] += rng.normal(0.0, rng.uniform(2.0, 15.0), (int(wrong.sum()), 2))
    weights = np.clip(rng.normal(np.where(wrong | hidden, 0.65, 0.85), 0.12), 0.3, 1.0)
    sigma = rng.uniform(*ranges.depth_noise)
    points_a, known_a = lift(_noisy(rng, a.depth, sigma), camera_a, pixels_a)
    points_b, known_b = lift(_noisy(rng, b.depth, sigma), camera_b, pixels_b)
    k = kept & known_a & known_b
    return LiftedMatches(points_a[k], points_b[k], pixels_a[k], pixels_b[k], weights[k])


def _on_surface(seen: Rendering, pixels: Float64, z: Float64) -> Bool:
    """Which pixels (N, 2) with depth z (N,) metres lie on the shape where it is visible."""
    h, w = seen.depth.shape
    u, v = np.rint(pixels).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < w) & (v < h)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    return np.asarray(
        inside & (seen.object_index[v, u] == 0) & (np.abs(seen.depth[v, u] - z) < SAME_SURFACE_M)
    )


def _drift(rng: np.random.Generator, pixels: Float64, size_px: float) -> Float64:
    """A smooth error of flow (N, 2) with about `size_px` standard deviation."""
    waves = rng.normal(0.0, 2 * np.pi / 120.0, (3, 2))
    phase = pixels @ waves.T + rng.uniform(0.0, 2 * np.pi, 3)
    return np.asarray(size_px * np.sin(phase) @ rng.normal(0.0, 0.8, (3, 2)))


def _noisy(rng: np.random.Generator, depth: Float32, sigma: float) -> Float32:
    """Depth (H, W) with the patchy noise of stereo matching: `sigma` metres at one metre."""
    noise = cv2.GaussianBlur(rng.normal(size=depth.shape).astype(np.float32), (0, 0), 1.5)
    scale = sigma / max(float(noise.std()), 1e-6)
    return np.where(depth > 0, depth + scale * noise * depth**2, 0.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class RotationSample:
    """features (128, 15), weights (128,) as the network gets them; R_canon (3, 3) that it has to answer."""

    features: Float32
    weights: Float32
    R_canon: Float32


def sample_of(turn: Turn, kind: Kind) -> RotationSample | None:
    """The question that the tracker would ask about a turn, with its true answer."""
    question = posed(turn.matches, kind, RobustKabsch())
    if question is None:
        return None
    features, weights = fixed_count(question.seen.features, turn.matches.weights)
    left = turn.T_b_a[:3, :3] @ question.R_first.T
    return RotationSample(features, weights, question.seen.canonical_rotation(left).astype(np.float32))


def endless(seed: int, stream: int, kind: Kind, ranges: TurnRange | None = None) -> Iterator[RotationSample]:
    """Samples without end; the same seed and stream give the same ones. Neighbours share a shape: shuffle."""
    rng = np.random.default_rng([seed, stream])
    ranges = TurnRange() if ranges is None else ranges
    while True:
        for turn in draw_turns(rng, ranges):
            sample = sample_of(turn, kind)
            if sample is not None:
                yield sample
