"""Closed shapes built from charts: pieces of surface that are flattened, so that a texture fits on them.

Two kinds: blocks on an uneven lattice, and surfaces of revolution. z is up; textures are upright and not
mirrored when seen from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from huepose.geometry.arrays import Bool, Float64, Int64

# Per face direction: which axis and sign is right and which is up, when the face is seen from outside.
_VIEWS = {
    (0, -1): ((1, -1), (2, 1)),
    (0, 1): ((1, 1), (2, 1)),
    (1, -1): ((0, 1), (2, 1)),
    (1, 1): ((0, -1), (2, 1)),
    (2, -1): ((0, -1), (1, 1)),
    (2, 1): ((0, 1), (1, 1)),
}


OPEN_TOP: Bool = np.ones((3, 3, 2), bool)
OPEN_TOP[1, 1, 1] = False
"""The filled cells of a box that is open above: walls and a floor."""


@dataclass(frozen=True, eq=False)
class Chart:
    """corners (N, 3, 3) m: triangles, outward by the right-hand rule; flat (N, 3, 2) m: positions of their
    corners on the texture, right and down from its top-left; size: (width, height) of the texture in
    metres."""

    corners: Float64
    flat: Float64
    size: tuple[float, float]


def blocks(
    xs: Sequence[float], ys: Sequence[float], zs: Sequence[float], filled: Bool, cell_m: float = 0.012
) -> list[Chart]:
    """The surface of the filled cells (X-1, Y-1, Z-1) between the lattice planes xs, ys, zs.

    One chart per plane and side, in the order -x, +x, -y, +y, -z, +z, and by coordinate within each.
    Faces are divided into cells with sides of at most about `cell_m`.
    """
    axes: list[Float64] = []
    for k, lines in enumerate((xs, ys, zs)):
        cuts = [max(1, int(np.ceil((b - a) / cell_m - 1e-9))) for a, b in pairwise(lines)]
        filled = np.repeat(filled, cuts, axis=k)
        axes.append(
            np.concatenate(
                [
                    np.linspace(a, b, n, endpoint=False)
                    for a, b, n in zip(lines, lines[1:], cuts, strict=False)
                ]
                + [np.array(lines[-1:], np.float64)]
            )
        )
    solid = np.pad(filled, 1)
    charts = []
    for axis in range(3):
        for side in (-1, 1):
            inner = np.roll(solid, -side, axis)  # the neighbour in the direction of the face
            faces = np.argwhere(solid & ~inner) - 1
            planes = faces[:, axis] + (side + 1) // 2
            charts += [_plane(axes, faces[planes == p], axis, side, int(p)) for p in np.unique(planes)]
    return charts


def _plane(axes: list[Float64], cells: Int64, axis: int, side: int, plane: int) -> Chart:
    (right, right_sign), (up, up_sign) = _VIEWS[axis, side]
    quads = np.empty((len(cells), 4, 3))
    for k, (along, high) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):  # counter-clockwise from bottom-left
        quads[:, k, axis] = axes[axis][plane]
        quads[:, k, right] = axes[right][cells[:, right] + (along if right_sign > 0 else 1 - along)]
        quads[:, k, up] = axes[up][cells[:, up] + (high if up_sign > 0 else 1 - high)]
    corners = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    flat = np.stack([corners[..., right] * right_sign, -corners[..., up] * up_sign], -1)
    return flattened(corners, flat)


def flattened(corners: Float64, flat: Float64) -> Chart:
    """A chart of triangles (N, 3, 3) m with texture positions flat (N, 3, 2) m about any origin; triangles
    without area are left out."""
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = np.linalg.norm(sides, axis=1) > 1e-12
    corners, flat = corners[kept], flat[kept]
    flat = flat - flat.reshape(-1, 2).min(0)
    width, height = flat.reshape(-1, 2).max(0)
    return Chart(corners, flat, (float(width), float(height)))


def revolved(parts: Sequence[Sequence[tuple[float, float]]], segments: int = 48) -> list[Chart]:
    """The surface of revolution about z of a profile. Its parts (K, 2) of radius and height go from the
    bottom of the axis along the outside to the top of the axis; each part begins where the last one ended.

    The texture of a part that touches the axis is projected along the axis; that of any other part is
    unrolled.
    """
    charts = []
    angle = np.linspace(0.0, 2 * np.pi, segments + 1)
    turn = np.stack([np.cos(angle), np.sin(angle)], -1)
    turn[-1] = turn[0]
    for part in parts:
        profile = np.asarray(part, np.float64)
        points = np.concatenate(
            [
                profile[:, None, :1] * turn[None],
                np.broadcast_to(profile[:, None, 1:], (len(profile), segments + 1, 1)),
            ],
            -1,
        )
        if (profile[:, 0] == 0).any():
            flat = points[..., :2] * (-1.0 if profile[0, 0] == 0 else 1.0, -1.0)
        else:
            rise = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
            around = angle * profile[:, 0].max()
            flat = np.stack(np.broadcast_arrays(around[None], -rise[:, None]), -1)
        corners, flat_corners = grid_triangles(points), grid_triangles(flat)
        charts.append(flattened(corners, flat_corners))
    return charts


def grid_triangles(grid: Float64) -> Float64:
    """Triangles (N, 3, D) of a grid (R, C, D): rows go up the profile, columns around the axis."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    dims = grid.shape[-1]
    return np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3, dims), np.stack([a, c, d], 2).reshape(-1, 3, dims)]
    )
