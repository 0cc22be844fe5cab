"""Closed surfaces through rounded cross-sections along a line: soft boxes, handles, hulls, bowls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.scenes.charts import Chart, flattened, grid_triangles

SEGMENTS = 40
"""Corners of a cross-section."""

STEP_M = 0.008
"""Longest step along the line, so that triangles stay small."""


def loft(
    centres: Sequence[Sequence[float]] | Float,
    radii: Sequence[Sequence[float]] | Float,
    power: float = 2.0,
    axis: tuple[float, float, float] | None = (0.0, 0.0, 1.0),
    across: tuple[float, float, float] = (1.0, 0.0, 0.0),
) -> list[Chart]:
    """Three charts: the first end, the side unrolled, the last end.

    centres (K, 3) m; radii (K, 2) m: of each cross-section along `across` and at right angles to it; power:
    2 is an ellipse, 1 a diamond, larger ones near a rectangle; axis: what cross-sections are at right angles
    to, None for the line itself."""
    middle, radius = _dense(np.asarray(centres, np.float64), np.asarray(radii, np.float64))
    along = np.gradient(middle, axis=0) if axis is None else np.broadcast_to(np.array(axis), middle.shape)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    u = np.array(across) - (along @ np.array(across))[:, None] * along
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(along, u)
    angle = np.linspace(0.0, 2 * np.pi, SEGMENTS + 1)
    turn = np.stack([np.cos(angle), np.sin(angle)], -1)
    turn[-1] = turn[0]
    reach = (np.abs(turn[None] / radius[:, None]) ** power).sum(-1) ** (-1.0 / power)
    flat_rings = reach[..., None] * turn  # (K, SEGMENTS + 1, 2)
    rings = middle[:, None] + flat_rings[..., :1] * u[:, None] + flat_rings[..., 1:] * v[:, None]
    steps = np.linalg.norm(np.diff(rings, axis=1), axis=2)
    around = np.concatenate([[0.0], np.cumsum(steps.max(0))])
    rise = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rings, axis=0), axis=2).max(1))])
    side = np.stack(np.broadcast_arrays(around[None], -rise[:, None]), -1)
    return [
        _end(rings[0], middle[0], flat_rings[0], first=True),
        flattened(grid_triangles(rings), grid_triangles(side)),
        _end(rings[-1], middle[-1], flat_rings[-1], first=False),
    ]


def _end(ring: Float64, middle: Float64, flat_ring: Float64, first: bool) -> Chart:
    """What closes an end: smaller and smaller rings about its middle."""
    count = max(2, int(np.ceil(np.linalg.norm(ring - middle, axis=1).max() / STEP_M)))
    shares = np.linspace(0.0, 1.0, count + 1)[:: 1 if first else -1, None, None]
    points, flat = middle + shares * (ring - middle), shares * flat_ring * (-1.0 if first else 1.0, -1.0)
    return flattened(grid_triangles(points), grid_triangles(flat))


def _dense(centres: Float64, radii: Float64) -> tuple[Float64, Float64]:
    """The same line with more cross-sections, none farther apart than STEP_M."""
    reach = np.abs(np.diff(radii, axis=0)).max(1)
    steps = np.maximum(np.linalg.norm(np.diff(centres, axis=0), axis=1), reach)
    counts = np.maximum(1, np.ceil(steps / STEP_M).astype(int))
    at = np.concatenate([*(k + np.arange(n) / n for k, n in enumerate(counts)), [len(centres) - 1.0]])
    known = np.arange(len(centres))
    return (
        np.stack([np.interp(at, known, column) for column in centres.T], -1),
        np.stack([np.interp(at, known, column) for column in radii.T], -1),
    )


def arc(
    middle: tuple[float, float, float], radii: tuple[float, float], degrees: tuple[float, float]
) -> Float64:
    """Points (K, 3) of an ellipse's arc in the x-z plane, 0 degrees at +x, 90 at +z."""
    angle = np.radians(np.linspace(*degrees, 17))
    zero = np.zeros_like(angle)
    around = np.stack([radii[0] * np.cos(angle), zero, radii[1] * np.sin(angle)], -1)
    return np.asarray(np.array(middle) + around)
