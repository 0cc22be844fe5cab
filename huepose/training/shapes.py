"""Random textured objects for training: packages, cans, bottles, and unions of deformed superquadrics.

Superquadrics include boxes, cylinders, balls and octahedra. Taper, bend, twist and smooth dents make each one
different, so that a network cannot memorise shapes (paper, section III-E). Surfaces have pictures, text and
stripes, because flow needs texture; some sides are plain.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64, Int32
from huepose.geometry.mesh import Mesh
from huepose.scenes import textures
from huepose.scenes.charts import Chart, blocks, revolved
from huepose.scenes.shapes import printed
from huepose.training.household import household_object, random_art, random_palette, sized

RINGS, SPOKES = 18, 30
"""Vertices of a shape from pole to pole, and around it."""

MAX_PARTS = 4
PART_PX = 512
"""Side of the texture of one part of a shape."""

HOUSEHOLD, ANY_COLORS = 0.4, 0.4
"""Share of household objects; share of the packages and cans with unrelated colours."""


def random_object(rng: np.random.Generator, diameter_m: float) -> Mesh:
    """A closed, textured mesh about the origin whose bounding box has a diagonal of `diameter_m` metres: a
    household object, or else, with equal chance, a package, can or bottle, or a union of superquadrics."""
    if rng.random() < HOUSEHOLD:
        return household_object(rng, diameter_m)
    if rng.random() < 0.5:
        return random_shape(rng, diameter_m)
    charts = _package(rng) if rng.random() < 0.5 else _can(rng)
    arts = [random_art(rng) for _ in charts]
    colors = random_palette(rng) if rng.random() < ANY_COLORS else textures.palette(rng.uniform(), rng)
    made = printed(charts, arts, colors, rng, 2 * PART_PX)
    return sized(made, diameter_m)


def _package(rng: np.random.Generator) -> list[Chart]:
    """A box of any proportions, or a step."""
    x, y, z = rng.uniform(0.2, 1.0, 3) * rng.choice([0.4, 1.0], 3)
    if rng.random() < 0.7:
        return blocks([-x, x], [-y, y], [-z, z], np.ones((1, 1, 1), bool), 0.5)
    return blocks([-x, 0, x], [-y, y], [-z, 0, z], np.array([[[1, 1]], [[1, 0]]], bool), 0.5)


def _can(rng: np.random.Generator) -> list[Chart]:
    """A surface of revolution with a lid and a bottom: straight like a can or waisted like a bottle."""
    height, knots = rng.uniform(0.15, 1.5), int(rng.integers(2, 7))
    radii = rng.uniform(0.15, 0.5) * np.ones(12)
    if rng.random() < 0.6:
        radii *= np.interp(np.linspace(0, 1, 12), np.linspace(0, 1, knots), rng.uniform(0.4, 1.3, knots))
    z = np.linspace(-height, height, 12)
    side = [(float(r), float(h)) for r, h in zip(radii, z, strict=True)]
    bottom, top = [(0.0, -height), side[0]], [side[-1], (0.0, height)]
    return revolved([bottom, side, top], 32)


def random_shape(rng: np.random.Generator, diameter_m: float) -> Mesh:
    """A closed mesh of one to four parts about the origin, each with a texture of its own; its bounding box's
    diagonal measures `diameter_m` metres."""
    parts = [_part(rng) for _ in range(int(rng.integers(1, MAX_PARTS + 1)))]
    vertices, faces, first = [], [], 0
    texture = np.zeros((2 * PART_PX, 2 * PART_PX, 3), np.uint8)
    uv = []
    for k, (points, triangles) in enumerate(parts):
        # Later parts are centred on the surface of the first, so that all are connected.
        at = parts[0][0][rng.integers(len(parts[0][0]))] if k else np.zeros(3)
        size = 1.0 if k == 0 else rng.uniform(0.25, 0.8)
        R = random_rotation(rng)
        vertices.append(size * points @ R.T + at)
        faces.append(triangles + first)
        first += len(points)
        column, row = k % 2, k // 2
        there = np.s_[row * PART_PX : (row + 1) * PART_PX, column * PART_PX : (column + 1) * PART_PX]
        palette = textures.palette(rng.uniform(), rng)
        texture[there] = random_art(rng)(rng, PART_PX, PART_PX, palette)
        uv.append((_around() + np.array([column, row])) / 2)
    f = np.concatenate(faces).astype(np.int32)
    made = Mesh(np.concatenate(vertices), f, np.concatenate(uv).astype(np.float32), texture)
    return sized(made, diameter_m)


def random_rotation(rng: np.random.Generator) -> Float64:
    """A uniformly distributed rotation (3, 3)."""
    q = rng.normal(size=4)
    return se3.rotation_from_quaternion(q / np.linalg.norm(q))


def _part(rng: np.random.Generator) -> tuple[Float64, Int32]:
    """Vertices (V, 3) of about unit size and faces (F, 3) of one deformed superquadric."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, RINGS)[:, None]
    longitude = np.linspace(-np.pi, np.pi, SPOKES, endpoint=False)[None]
    roundness = rng.choice([0.15, 0.4, 1.0, 1.6], 2) * rng.uniform(0.8, 1.2, 2)
    ring = _power(np.cos(latitude), roundness[0])
    points = np.stack(
        [
            ring * _power(np.cos(longitude), roundness[1]),
            ring * _power(np.sin(longitude), roundness[1]),
            _power(np.sin(latitude), roundness[0]) * np.ones_like(longitude),
        ],
        -1,
    ).reshape(-1, 3)
    points *= rng.uniform(0.3, 1.0, 3)
    z = points[:, 2:]
    points[:, :2] *= 1.0 + rng.uniform(-0.5, 0.5) * z
    points[:, :1] += rng.uniform(-0.5, 0.5) * z**2
    angle = rng.uniform(-0.8, 0.8) * z[:, 0]
    x, y = points[:, 0].copy(), points[:, 1].copy()
    points[:, 0] = np.cos(angle) * x - np.sin(angle) * y
    points[:, 1] = np.sin(angle) * x + np.cos(angle) * y
    return points * (1.0 + _dents(points, rng)[:, None]), _faces()


def _power(x: Float64, exponent: float) -> Float64:
    return np.asarray(np.sign(x) * np.abs(x) ** exponent)


def _dents(points: Float64, rng: np.random.Generator) -> Float64:
    """Relative radial displacement (V,) by a few smooth waves through space."""
    waves = int(rng.integers(0, 7))
    directions = rng.normal(size=(waves, 3)) * rng.uniform(1.5, 6.0, (waves, 1))
    heights = rng.uniform(0.0, 0.12, waves)
    return np.asarray(np.sin(points @ directions.T + rng.uniform(0, 2 * np.pi, waves)) @ heights)


def _faces() -> Int32:
    ring, spoke = np.meshgrid(np.arange(RINGS - 1), np.arange(SPOKES), indexing="ij")
    following = (spoke + 1) % SPOKES
    a, b = ring * SPOKES + spoke, ring * SPOKES + following
    c, d = a + SPOKES, b + SPOKES
    faces = np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)], 2)
    return np.asarray(faces.reshape(-1, 3), np.int32)


def _around() -> Float64:
    """Texture coordinates (F, 3, 2), 0..1, of the corners of `_faces`; the rim of the texture is not used."""
    ring, spoke = np.meshgrid(np.arange(RINGS - 1), np.arange(SPOKES), indexing="ij")
    left, right = spoke / SPOKES, (spoke + 1) / SPOKES
    low, high = 1 - ring / (RINGS - 1), 1 - (ring + 1) / (RINGS - 1)
    a, b, c, d = (np.stack(x, -1) for x in ((left, low), (right, low), (left, high), (right, high)))
    corners = np.stack([np.stack([a, b, d], 2), np.stack([a, d, c], 2)], 2)
    return np.asarray(0.01 + 0.98 * corners.reshape(-1, 3, 2))
