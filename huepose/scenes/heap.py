"""Heaps of objects on a table, and a box around them: each object is lowered until it touches a surface.

Surfaces are height maps, rendered from far above and far below, so objects do not visibly penetrate each
other. Forces are not modelled: an object may rest on a single point.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float32, Float64, Rng, UInt8
from huepose.rendering import render_depth
from huepose.scenes import textures
from huepose.scenes.charts import OPEN_TOP, blocks
from huepose.scenes.shapes import printed
from huepose.scenes.textures import Palette

CELL_M = 0.002
_FAR_M = 200.0
"""Distance of the camera that renders the height maps: its rays are parallel to one part in a thousand."""

_GAP_M = 0.0005
"""Distance between objects that lie on each other, so that their surfaces do not intersect."""

_LYING_SHARE = 0.7
_SAME_AREA = 9
"""Decimals of areas in square metres: they are rounded so that equal sides keep their order on every CPU."""


@dataclass(eq=False)
class Heap:
    """A square of the table with its centre at the origin, z up. heights (N, N) m: row 0 is at the far end
    (+y)."""

    side_m: float = 1.0
    heights: Float32 = field(init=False)

    def __post_init__(self) -> None:
        n = round(self.side_m / CELL_M)
        self.heights = np.zeros((n, n), np.float32)

    def drop(self, mesh: Mesh, R: Float64, places: Float64) -> Float64:
        """Lower a mesh, rotated by R (3, 3), at that of the positions `places` (K, 2) m where it comes to
        rest lowest. Positions where it would stick out of the square are moved inwards.

        Returns T_table_mesh (4, 4). Raises ValueError if it does not fit on the square."""
        T = se3.make(R, -(R @ mesh.centre))
        reach = float(np.abs(se3.apply(T, mesh.vertices)[:, :2]).max())
        n = 2 * (int(reach / CELL_M) + 2) + 1
        top, bottom = _height_map(mesh, T, n, above=True), _height_map(mesh, T, n, above=False)
        best_z, best_at = np.inf, (0, 0)
        middle, last = self.heights.shape[0] // 2, self.heights.shape[0] - n
        if last < 0:
            raise ValueError(f"a thing of {2 * reach:.2f} m does not fit on {self.side_m:.2f} m")
        for x, y in places:
            row = min(max(middle - round(y / CELL_M) - n // 2, 0), last)
            column = min(max(middle + round(x / CELL_M) - n // 2, 0), last)
            under = self.heights[row : row + n, column : column + n]
            z = float((under - bottom)[np.isfinite(bottom)].max()) + _GAP_M
            if z < best_z:
                best_z, best_at = z, (row, column)
        row, column = best_at
        under = self.heights[row : row + n, column : column + n]
        np.maximum(under, np.where(np.isfinite(top), top + np.float32(best_z), under), out=under)
        shift = [(column + n // 2 - middle) * CELL_M, (middle - row - n // 2) * CELL_M, best_z]
        return se3.make(np.eye(3), np.array(shift)) @ T


def _height_map(mesh: Mesh, T: Float64, n: int, *, above: bool) -> Float32:
    """Heights (n, n) of the highest or the lowest surface of a mesh at T, infinite where there is none."""
    points = se3.apply(T, mesh.vertices)
    # From above, rows run against y and depth against z. From below, with the same rows and columns, the
    # image would be mirrored, so the mesh is mirrored instead.
    points_cam = points * ([1.0, -1.0, -1.0] if above else [1.0, -1.0, 1.0]) + [0.0, 0.0, _FAR_M]
    focal = _FAR_M / CELL_M
    camera = Camera(focal, focal, (n - 1) / 2, (n - 1) / 2, n, n)
    placed = Mesh(points_cam.astype(np.float32), mesh.faces, mesh.uv, mesh.texture)
    depth = render_depth(placed, np.eye(4), camera)
    height = _FAR_M - depth if above else depth - _FAR_M
    return np.where(depth > 0, height, np.inf if not above else -np.inf).astype(np.float32)


def resting_turns(mesh: Mesh) -> tuple[Float64, Float64]:
    """Rotations (K, 3, 3) that lay a flat side of the convex hull on the table, and the areas (K,) m^2 of
    these sides.

    Only sides under the centre of the bounding box count; a shape without such a side is not rotated."""
    try:
        hull = ConvexHull(mesh.vertices.astype(np.float64))
    except QhullError:
        return np.eye(3)[None], np.ones(1)
    corners = mesh.vertices[hull.simplices].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    areas, normals = np.round(areas, _SAME_AREA), hull.equations[:, :3]
    sides: list[tuple[Float64, float]] = []
    left = np.ones(len(areas), bool)
    for k in np.argsort(-areas, kind="stable"):
        if not left[k]:
            continue
        same = left & (normals @ normals[k] > np.cos(np.radians(4.0)))
        left &= ~same
        foot = corners[same].reshape(-1, 3)
        aside = mesh.centre - foot.mean(0)
        aside = aside - normals[k] * (aside @ normals[k])
        if np.linalg.norm(aside) < 0.6 * np.linalg.norm(foot - foot.mean(0), axis=1).max():
            sides.append((normals[k], round(float(areas[same].sum()), _SAME_AREA)))
    sides = sorted(sides, key=lambda s: -s[1])[:12]
    if not sides:
        return np.eye(3)[None], np.ones(1)
    down = np.array([0.0, 0.0, -1.0])
    turns = [Rotation.align_vectors(down[None], n[None])[0].as_matrix() for n, _ in sides]
    return np.array(turns), np.array([a for _, a in sides])


def random_turn(mesh: Mesh, rng: Rng, lying: float = _LYING_SHARE) -> Float64:
    """A rotation (3, 3): with probability `lying` it rests on a flat side (large sides are more probable),
    else it is random."""
    if rng.random() >= lying:
        return np.asarray(Rotation.random(random_state=rng).as_matrix())
    turns, areas = resting_turns(mesh)
    k = int(rng.choice(len(turns), p=areas / areas.sum()))
    return np.asarray(se3.rotation_exp(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)])) @ turns[k])


def open_box(half_side_m: float, height_m: float, rng: Rng) -> Mesh:
    """An open box centred at the origin, with walls of 8 mm; one side is up to a fifth longer than the
    other."""
    x, y = half_side_m * rng.uniform(1.0, 1.2), half_side_m
    z, wall = height_m / 2.0, 0.008
    lattice = [-x - wall, -x, x, x + wall], [-y - wall, -y, y, y + wall], [-z, wall - z, z]
    charts = blocks(*lattice, OPEN_TOP, 0.05)
    return printed(charts, [_plain] * len(charts), textures.palette(rng.uniform(), rng), rng, 256)


def _plain(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    return textures.mixed(
        p.base, p.dark, 0.15 * textures.clouds(rng, height, width, max(height, width) / 3, 3)
    )
