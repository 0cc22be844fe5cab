"""View templates: small images of an object from all directions, at metric scale, rendered once, offline;
and tables of them: dense 8 x 8 cells for the quick look at all templates, lists of covered cells for the
close look at a few.

The pose of a template: with the object on the optical axis, `T_cam_obj` of direction v at roll r has the
rotation Rz(2 pi r / R) look_at(v). Rz rotates about the optical axis from x to y (clockwise in the image).
The origin lies at Rz(2 pi r / R) `origins[v]` from the point on the axis at the median depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_lab
from huepose.geometry import icosphere, se3
from huepose.geometry.arrays import Float, Float32, Float64, Int32, Int64, UInt8, UInt16
from huepose.geometry.camera import Camera
from huepose.geometry.icosphere import look_at
from huepose.geometry.mesh import Mesh
from huepose.model.types import ReferenceModel, ViewTemplates
from huepose.rendering.render import render
from huepose.support.kept import kept, once_for_each

LEVEL = 2
"""Subdivision level of the icosphere of directions: 162, 16 degrees apart."""
ROLLS = 24
"""Rotations about the line of sight, 15 degrees apart."""
SIDE = 16
"""Cells a side of a template."""
SPAN = 1.1
"""Width of a template in object diameters, at the median depth."""

_OVERSAMPLING = 6
"""Rendered pixels per cell and axis."""
DISTANCE_M, DISTANCE_DIAMETERS = 0.85, 2.5
"""Distance of the rendering camera, the larger of both, so that perspective does not distort large
objects."""


def build_templates(
    mesh: Mesh, diameter_m: float, *, level: int = LEVEL, rolls: int = ROLLS
) -> ViewTemplates:
    """Templates of a mesh from all directions of an icosphere of this level, at `rolls` rotations about the
    axis each."""
    directions = icosphere.directions(level)
    planes = np.empty((len(directions), rolls, 5, SIDE, SIDE), np.float16)
    origins = np.empty((len(directions), 3), np.float32)
    window = SIDE * _OVERSAMPLING
    distance = max(DISTANCE_M, DISTANCE_DIAMETERS * diameter_m)
    focal = window * distance / (SPAN * diameter_m)
    camera = Camera(focal, focal, window - 0.5, window - 0.5, 2 * window, 2 * window)
    for v, direction in enumerate(directions):
        R = icosphere.look_at(direction)
        T_cam_obj = se3.make(R, [0.0, 0.0, distance] - R @ mesh.centre)
        rendering = render([(mesh, T_cam_obj)], camera)
        covered = rendering.depth > 0
        rows, columns = np.nonzero(covered)
        if len(rows):
            centroid = np.array([columns.mean(), rows.mean()])
            median = float(np.median(rendering.depth[covered]))
        else:  # thinner than a pixel from here
            centroid, median = np.array([camera.cx, camera.cy]), distance
        origins[v] = T_cam_obj[:3, 3] - camera.backproject(centroid, np.array(median))
        image = np.zeros((*covered.shape, 5), np.float32)
        lab = cv2.cvtColor(rendering.color.astype(np.float32) / 255.0, cv2.COLOR_RGB2Lab)
        image[..., :3] = lab * covered[..., None]
        image[..., 3] = (rendering.depth - median) * covered
        image[..., 4] = covered
        for r in range(rolls):
            small = _rolled(image, centroid, 2 * np.pi * r / rolls, distance / median, window)
            planes[v, r] = small.transpose(2, 0, 1)
    return ViewTemplates(directions.astype(np.float32), planes, origins, SPAN)


def _rolled(image: Float32, centroid: np.ndarray, angle: float, scale: float, window: int) -> Float32:
    """One template (SIDE, SIDE, 5): the image (H, W, 5) rotated by `angle` (radians) about `centroid` (2,),
    cut to the window and box-averaged. scale: image pixels per window pixel. All channels but coverage are
    divided by coverage."""
    c, s = np.cos(angle), np.sin(angle)
    A = np.array([[c, s], [-s, c]]) * scale  # from the rotated window back to the image
    offset = centroid - A @ np.full(2, (window - 1) / 2.0)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    large = cv2.warpAffine(image, np.column_stack([A, offset]), (window, window), flags=flags)
    small = cv2.resize(large, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    known = small[..., 4:] > 1e-3
    small[..., :4] = np.where(known, small[..., :4] / np.maximum(small[..., 4:], 1e-3), 0.0)
    small[..., 4:] *= known
    return np.asarray(small, np.float32)


COARSE_SIDE = 8
"""Cells a side in the quick look."""

AT_ONCE = 4
"""Cells that the quick look processes at once."""

BESIDE = 8
"""Cells that the close look processes at once."""

MILLIMETRES = 1000.0
COVERED = 0.5
"""Least coverage (0..1) of a cell that counts in the close look."""

STEPS, RELIEF_STEPS = 100.0, 10.0
"""Integer steps per opponent unit and per millimetre in the stored values."""

NOT_COVERED = np.int16(-32768)
"""Stored relief of a cell that pads a template."""


@dataclass(frozen=True, eq=False)
class TemplateTable:
    """Templates of V views in R rolls (N = V * R), built once for a model.

    For the quick look, over the P of 8 * 8 cells that any template covers. used (P,): their indices.
    Template i covers the cells begins[i] to begins[i + 1], padded with cells without coverage to a multiple
    of AT_ONCE. Of these, cells (K,) uint8: indices in `used`; numbers (K, 5) float32: coverage, opponents
    and relief in millimetres. area (N,): sum of coverage.

    For the close look. Template i covers covered[i] cells, starts[i] to starts[i + 1], padded with
    NOT_COVERED to a multiple of BESIDE. places (M,): in the window of side * side cells, row * 256 +
    column; values (4 * M,) int16, template by template: its three opponents in 1 / STEPS and its relief in
    1 / RELIEF_STEPS millimetres, one after the other.

    rotations (N, 3, 3), origins (N, 3): R_cam_obj, and the object's origin relative to the window's middle
    at median depth; span_m: the window's side.
    """

    used: Int64
    begins: Int64
    cells: UInt8
    numbers: Float32
    area: Float32
    covered: Int32
    starts: Int64
    places: UInt16
    values: np.ndarray
    side: int
    rotations: Float64
    origins: Float64
    span_m: float
    diameter_m: float


@once_for_each
def table_of(model: ReferenceModel) -> TemplateTable:
    """A model's view templates laid out for retrieval, memory-mapped as long as the model exists."""
    return kept(TemplateTable, model.digest, lambda: build_table(model.templates, model.diameter_m))


def build_table(templates: ViewTemplates, diameter_m: float) -> TemplateTable:
    """Build the tables of a model (0.2 s, about 4 MB)."""
    close = _listed(_planes(templates))
    coarse = coarse_views(templates)
    begins, cells, numbers = _padded(coarse)
    return TemplateTable(
        coarse.used,
        begins,
        cells,
        numbers,
        coarse.coverage.sum(1),
        *close,
        templates.planes.shape[-1],
        *view_poses(templates),
        templates.span * diameter_m,
        diameter_m,
    )


@dataclass(frozen=True, eq=False)
class CoarseViews:
    """Templates in 8 * 8 cells. used (P,): indices of the cells that any template covers; of these, coverage
    (N, P) float32 and values (N, P, 4) float32: opponents and relief in millimetres."""

    used: Int64
    coverage: Float32
    values: Float32


def coarse_views(templates: ViewTemplates, min_coverage: float = 0.5) -> CoarseViews:
    """The cells of all views at all rolls. min_coverage: least coverage of a cell that counts."""
    planes = _planes(templates)
    planes[:, :4] *= planes[:, 4:]  # the mean over a larger cell is weighted by coverage
    mean = _averaging(planes.shape[-1])
    coarse = mean @ planes @ mean.T
    coarse[:, :4] /= np.maximum(coarse[:, 4:], 1e-3)
    coverage, values = _coverage_and_values(coarse)
    flat = np.where(coverage > min_coverage, coverage, 0.0).reshape(len(planes), -1).astype(np.float32)
    used = np.flatnonzero(flat.any(0))
    return CoarseViews(used, np.ascontiguousarray(flat[:, used]), values.reshape(len(planes), -1, 4)[:, used])


def _padded(coarse: CoarseViews) -> tuple[Int64, UInt8, Float32]:
    """Begins (N + 1,), cells (K,) and numbers (K, 5) of a TemplateTable."""
    covered = coarse.coverage > 0
    counts = covered.sum(1)
    begins = np.concatenate([[0], np.cumsum(-(-counts // AT_ONCE) * AT_ONCE)]).astype(np.int64)
    which, cell = np.nonzero(covered)
    place = np.arange(len(which)) + (begins[:-1] - np.cumsum(counts) + counts)[which]
    cells, numbers = np.zeros(begins[-1], np.uint8), np.zeros((begins[-1], 5), np.float32)
    cells[place] = cell
    numbers[place, 0], numbers[place, 1:] = coarse.coverage[covered], coarse.values[covered]
    return begins, cells, numbers


def _planes(templates: ViewTemplates) -> Float32:
    """The planes (N, 5, S, S) of all views at all rolls."""
    return templates.planes.reshape(-1, *templates.planes.shape[2:]).astype(np.float32)


def _listed(planes: Float32) -> tuple[Int32, Int64, UInt16, np.ndarray]:
    """The cells that planes (N, 5, S, S) cover, as in TemplateTable: covered (N,), starts (N + 1,), places
    (M,) and values (4 * M,)."""
    which, row, column = np.nonzero(planes[:, 4] >= COVERED)
    counts = np.bincount(which, minlength=len(planes))
    filled = -(-counts // BESIDE) * BESIDE
    starts = np.concatenate([[0], np.cumsum(filled)]).astype(np.int64)
    within = np.arange(len(which)) - (np.cumsum(counts) - counts)[which]
    places = np.zeros(starts[-1], np.uint16)
    places[starts[which] + within] = row << 8 | column
    values = np.full(4 * starts[-1], NOT_COVERED, np.int16)
    listed = _values(planes[which, :4, row, column])
    at = 4 * starts[which] + within
    for channel in range(3):
        values[at + channel * filled[which]] = np.rint(listed[:, channel] * STEPS)
    values[at + 3 * filled[which]] = np.rint(np.clip(listed[:, 3] * RELIEF_STEPS, -32000, 32000))
    return counts.astype(np.int32), starts, places, values


def _coverage_and_values(planes: Float) -> tuple[Float32, Float32]:
    """Coverage (N, S, S), and opponents with relief in millimetres (N, S, S, 4), of planes (N, 5, S, S) L,
    a, b, relief in metres, coverage."""
    return np.asarray(planes[:, 4], np.float32), _values(planes[:, :4].transpose(0, 2, 3, 1))


def _values(cells: Float) -> Float32:
    """Opponents with relief in millimetres (..., 4) of cells (..., 4) L, a, b, relief in metres."""
    values = np.array(cells, np.float32, order="C")
    values[..., :3] = opponents_of_lab(np.ascontiguousarray(values[..., :3]))
    values[..., 3] *= np.float32(MILLIMETRES)
    return values


def _averaging(side: int) -> Float32:
    """Matrix (COARSE_SIDE, side) whose rows average the cells that fall into each larger cell."""
    edges = np.arange(COARSE_SIDE + 1) * (side / COARSE_SIDE)
    low, high = edges[:-1, None], edges[1:, None]
    cell = np.arange(side)[None, :]
    shared = np.clip(np.minimum(high, cell + 1) - np.maximum(low, cell), 0.0, None)
    return np.asarray(shared / (high - low), dtype=np.float32)


def view_poses(templates: ViewTemplates) -> tuple[Float64, Float64]:
    """Rotations (N, 3, 3) and origins (N, 3) of all views in all rolls."""
    rolls = templates.planes.shape[1]
    origins = np.einsum("rij,vj->vri", _roll_rotations(rolls), templates.origins.astype(np.float64))
    return view_rotations(templates.directions, rolls), origins.reshape(-1, 3)


def view_rotations(directions: Float, rolls: int) -> Float64:
    """Rotations R_cam_obj (V * rolls, 3, 3) of the views from directions (V, 3), each at all rolls."""
    looks = np.stack([look_at(d) for d in directions])
    return np.asarray(np.einsum("rij,vjk->vrik", _roll_rotations(rolls), looks).reshape(-1, 3, 3))


def _roll_rotations(rolls: int) -> Float64:
    """Rotations (rolls, 3, 3) about the optical axis, evenly spaced."""
    angles = 2 * np.pi * np.arange(rolls) / rolls
    rotations = np.zeros((rolls, 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles)
    rotations[:, 1, 0], rotations[:, 0, 1] = np.sin(angles), -np.sin(angles)
    rotations[:, 2, 2] = 1.0
    return rotations
