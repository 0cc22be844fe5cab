"""Renders textured meshes for any pinhole camera, crops included: depth, colour, surface coordinates.

A scalar z-buffer rasteriser on the CPU: small, exact, and fast if objects are small in the image. Normals
and points are computed when they are read, also for some pixels alone. All kernels release the interpreter
lock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int32, Int64, UInt8
from huepose.geometry.camera import NEAR_M, Camera
from huepose.geometry.mesh import Mesh
from huepose.rendering.raster import depth_of, rasterise, transform
from huepose.rendering.shade import Rasterised, locate, paint, rotate_normals
from huepose.rendering.textures import Pyramid, build_pyramid
from huepose.support.jit import jit
from huepose.support.kept import kept, once_for_each

_SNAP = 2.0**20


class _Prepared:
    """Data computed once per mesh, at the first request."""

    def __init__(self, mesh: Mesh) -> None:
        self.faces: Int32 = np.ascontiguousarray(mesh.faces, dtype=np.int32)
        self.vertices: Float32 = np.ascontiguousarray(mesh.vertices, dtype=np.float32)
        self.uv: Float32 = np.ascontiguousarray(mesh.uv, dtype=np.float32)
        # Only arrays are kept: a mesh that refers to itself from the cache would never be freed.
        self._parts, self._digest = (mesh.vertices, mesh.faces, mesh.uv, mesh.texture), mesh.digest

    @cached_property
    def pyramid(self) -> Pyramid:
        return kept(Pyramid, self._digest, lambda: build_pyramid(Mesh(*self._parts)))

    @cached_property
    def corner_normals(self) -> Float32:
        return corner_normals(Mesh(*self._parts))

    @cached_property
    def closed(self) -> bool:
        """Whether the surface has no border and its faces look outwards. Then its back faces are never
        visible."""
        return is_closed(self.vertices, self.faces)

    def may_skip_back_faces(self, points_cam: Float64, near_m: float) -> bool:
        """Whether back faces can be skipped: the surface is closed, and all of it is beyond `near_m`."""
        return self.closed and bool(points_cam[:, 2].min() > near_m)

    @cached_property
    def corner_points(self) -> Float32:
        return np.ascontiguousarray(self.vertices[self.faces])


_prepare = once_for_each(_Prepared)


@dataclass(frozen=True, eq=False)
class _Part:
    """A mesh as it was rendered at a pose T (4, 4)."""

    mesh: _Prepared
    T: Float64
    where: Rasterised

    def pixels(self) -> tuple[Int64, Int64]:
        """Rows and columns (N,) of the pixels that show it."""
        left, top, right, bottom = self.where.bounds
        rows, columns = np.nonzero(self.where.owner[top : bottom + 1, left : right + 1] == self.where.number)
        return rows + top, columns + left

    def add_points(self, rows: Int64, columns: Int64, out: Float32) -> None:
        """Writes points into out (N, 3), at those of the pixels (N,) that show it."""
        locate(self.where, self.mesh.corner_points, rows, columns, out)

    def add_normals(self, rows: Int64, columns: Int64, out: Float32) -> None:
        """Writes normals into out (N, 3), at those of the pixels (N,) that show it."""
        locate(self.where, self.mesh.corner_normals, rows, columns, out)
        rotate_normals(self.where, np.ascontiguousarray(self.T[:3, :3]), rows, columns, out)


_Add = Callable[[_Part, Int64, Int64, Float32], None]


@dataclass(frozen=True, eq=False)
class Rendering:
    """What a camera sees of some meshes.

    depth (H, W) float32 metres, 0 = nothing; color (H, W, 3) uint8 RGB, 0 = nothing, or (0, 0, 3) if it was
    not requested; object_index (H, W) int16, position in the scene, -1 = nothing.
    """

    depth: Float32
    color: UInt8
    object_index: np.ndarray[tuple[int, ...], np.dtype[np.int16]]
    _parts: tuple[_Part, ...]

    @cached_property
    def normals_cam(self) -> Float32:
        """(H, W, 3) float32, unit, towards the camera, 0 = nothing."""
        return self._everywhere(_Part.add_normals)

    @cached_property
    def points_obj(self) -> Float32:
        """(H, W, 3) float32 metres in the frame of the visible object, 0 = nothing."""
        return self._everywhere(_Part.add_points)

    def normals_at(self, rows: Int64, columns: Int64) -> Float32:
        """Normals (N, 3) at some pixels (N,), as in `normals_cam`."""
        return self._at(_Part.add_normals, rows, columns)

    def points_at(self, rows: Int64, columns: Int64) -> Float32:
        """Points (N, 3) at some pixels (N,), as in `points_obj`."""
        return self._at(_Part.add_points, rows, columns)

    def _at(self, add: _Add, rows: Int64, columns: Int64) -> Float32:
        out = np.zeros((len(rows), 3), np.float32)
        for part in self._parts:
            add(part, rows, columns, out)
        return out

    def _everywhere(self, add: _Add) -> Float32:
        """Each mesh is asked for its own pixels only: a room has twenty meshes."""
        height, width = self.depth.shape
        out = np.zeros((height * width, 3), np.float32)
        for part in self._parts:
            rows, columns = part.pixels()
            own = np.zeros((len(rows), 3), np.float32)
            add(part, rows, columns, own)
            out[rows * width + columns] = own
        return out.reshape(height, width, 3)


def is_closed(vertices: Float32, faces: Int32) -> bool:
    """Whether faces (F, 3) are the boundary of a solid, counter-clockwise as seen from outside: each edge
    exists once in each direction, and the volume is positive."""
    if not len(faces):
        return False
    a, b = faces.astype(np.int64).ravel(), np.roll(faces.astype(np.int64), -1, axis=1).ravel()
    there, back = np.sort(a * len(vertices) + b), np.sort(b * len(vertices) + a)
    if (np.diff(there) == 0).any() or not np.array_equal(there, back):
        return False
    p, q, r = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.einsum("ni,ni->", p, np.cross(q, r))) > 0.0


def _intrinsics(camera: Camera) -> tuple[tuple[float, float], tuple[float, float]]:
    """Focal lengths and principal point. The latter is rounded to 2^-20 px, so that positions relative to
    it are the same numbers in a crop and in the whole image, and a crop equals the sub-image bit by bit."""
    cx, cy = round(camera.cx * _SNAP) / _SNAP, round(camera.cy * _SNAP) / _SNAP
    return (float(camera.fx), float(camera.fy)), (cx, cy)


def render(scene: Sequence[tuple[Mesh, Float]], camera: Camera, *, color: bool = True) -> Rendering:
    """Render meshes at poses `T_cam_obj` (4, 4) into one z-buffer.

    Colour is the bare texture (no light), filtered to the pixel. Normals are smooth over bends of less than
    40 degrees.
    """
    size = (camera.height, camera.width)
    inverse: Float32 = np.zeros(size, np.float32)
    face: Int32 = np.full(size, -1, np.int32)
    owner: Int32 = np.full(size, -1, np.int32)
    focal, centre = _intrinsics(camera)
    parts = []
    for index, (mesh, T_cam_obj) in enumerate(scene):
        part = _prepare(mesh)
        T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
        points_cam = transform(part.vertices, T)
        closed = part.may_skip_back_faces(points_cam, NEAR_M)
        bounds = rasterise(points_cam, part.faces, focal, centre, NEAR_M, closed, index, inverse, face, owner)
        where = Rasterised(owner, face, index, bounds, points_cam, part.faces, focal, centre)
        parts.append(_Part(part, T, where))
    color_out: UInt8 = np.zeros((*size, 3) if color else (0, 0, 3), np.uint8)
    if color:
        for rendered in parts:
            p = rendered.mesh.pyramid
            paint(rendered.where, rendered.mesh.uv, p.texels, p.levels, color_out)
    return Rendering(depth_of(inverse), color_out, owner.astype(np.int16), tuple(parts))


def render_depth(mesh: Mesh, T_cam_obj: Float, camera: Camera, *, near_m: float = NEAR_M) -> Float32:
    """Depth (H, W) float32 metres of one mesh at `T_cam_obj` (4, 4), 0 = nothing: cheaper than `render`."""
    part = _prepare(mesh)
    size = (camera.height, camera.width)
    inverse: Float32 = np.zeros(size, np.float32)
    face: Int32 = np.empty(size, np.int32)
    focal, centre = _intrinsics(camera)
    points_cam = transform(part.vertices, np.ascontiguousarray(T_cam_obj, dtype=np.float64))
    closed = part.may_skip_back_faces(points_cam, near_m)
    rasterise(points_cam, part.faces, focal, centre, float(near_m), closed, 0, inverse, face, face)
    return depth_of(inverse)


CREASE_COS = float(np.cos(np.radians(40.0)))  # faces that bend more than this keep a sharp edge


def corner_normals(mesh: Mesh) -> Float32:
    """Unit normals (F, 3, 3) float32 at the corners of the faces, in the mesh frame.

    Corners at the same position count as one vertex, whatever their uv. Each takes the mean normal of those
    faces there that bend less than 40 degrees from its own, weighted by the angle of each face at that
    corner. So it does not matter how flat parts are cut into triangles (Thuermer and Wuethrich 1998).
    """
    normals, _ = mesh.face_normals()
    angles = _corner_angles(mesh)
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corner_place = place.reshape(-1)[mesh.faces.reshape(-1)]
    order = np.argsort(corner_place, kind="stable")
    starts = np.searchsorted(corner_place[order], np.arange(corner_place.max(initial=-1) + 2))
    return _smooth(normals, angles, corner_place, order, starts)


def _corner_angles(mesh: Mesh) -> Float64:
    """Angles (3 F,) in radians at the corners of the faces."""
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    ahead = np.roll(corners, -1, axis=1) - corners
    ahead /= np.maximum(np.linalg.norm(ahead, axis=2, keepdims=True), 1e-18)
    back = -np.roll(ahead, 1, axis=1)
    return np.asarray(np.arccos(np.clip((ahead * back).sum(2), -1.0, 1.0)).reshape(-1), np.float64)


@jit
def _smooth(normals: Float64, weights: Float64, places: Int64, corners_at: Int64, starts: Int64) -> Float32:
    out = np.empty((normals.shape[0], 3, 3), np.float32)
    for f in range(normals.shape[0]):
        for c in range(3):
            place = places[3 * f + c]
            x, y, z = 0.0, 0.0, 0.0
            for k in range(starts[place], starts[place + 1]):
                corner = corners_at[k]
                g = corner // 3
                cos = (
                    normals[f, 0] * normals[g, 0]
                    + normals[f, 1] * normals[g, 1]
                    + normals[f, 2] * normals[g, 2]
                )
                if cos > CREASE_COS or g == f:
                    x += weights[corner] * normals[g, 0]
                    y += weights[corner] * normals[g, 1]
                    z += weights[corner] * normals[g, 2]
            length = max(np.sqrt(x * x + y * y + z * z), 1e-30)
            out[f, c, 0], out[f, c, 1], out[f, c, 2] = x / length, y / length, z / length
    return out
