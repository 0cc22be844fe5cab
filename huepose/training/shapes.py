"""An endless supply of objects: bent and dented superquadrics, a few of them grown together.

Superquadrics run from boxes over cylinders and balls to octahedra; taper, bend, twist and smooth dents make
each one unlike any other, so that nothing of a shape can be learned by heart (paper, section III-E).
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64, Int32
from huepose.geometry.mesh import Mesh

RINGS, SPOKES = 18, 30
MAX_PARTS = 4


def random_shape(rng: np.random.Generator, diameter_m: float) -> Mesh:
    """A closed, untextured mesh of one to four parts about the origin; its bounding box's diagonal measures
    `diameter_m` metres."""
    parts = [_part(rng) for _ in range(int(rng.integers(1, MAX_PARTS + 1)))]
    vertices, faces, first = [], [], 0
    for k, (points, triangles) in enumerate(parts):
        # Later parts sit on the surface of the first, so that the whole hangs together.
        at = parts[0][0][rng.integers(len(parts[0][0]))] if k else np.zeros(3)
        size = 1.0 if k == 0 else rng.uniform(0.25, 0.8)
        turn = random_rotation(rng)
        vertices.append(size * points @ turn.T + at)
        faces.append(triangles + first)
        first += len(points)
    v = np.concatenate(vertices)
    v -= (v.min(0) + v.max(0)) / 2
    v *= diameter_m / np.linalg.norm(v.max(0) - v.min(0))
    f = np.concatenate(faces)
    return Mesh(
        v.astype(np.float32),
        f.astype(np.int32),
        np.zeros((len(f), 3, 2), np.float32),
        np.full((2, 2, 3), 128, np.uint8),
    )


def random_rotation(rng: np.random.Generator) -> Float64:
    """A rotation (3, 3), all equally likely."""
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
