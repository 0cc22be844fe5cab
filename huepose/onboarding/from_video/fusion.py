"""Fuse views to one surface: by Open3D's truncated signed distance field, and by the visual hull where
nothing was measured. Its texture comes from the images, so it is finer than the cells of the volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int32
from huepose.geometry.camera import depth_noise_m
from huepose.geometry.mesh import Mesh
from huepose.onboarding.from_video.views import View, projected, tolerance_m, votes
from huepose.onboarding.patches import fitting_patches
from huepose.onboarding.texture import reduced
from huepose.propose.flow import sampled

CELLS, FEW_CELLS = 128, 64
"""Cells along a side of the volume: for the final mesh, and for the surface that frames are registered
with."""

SMALLEST_CELL_M = 0.001
"""Least side of a cell: the volume of a small object is made larger to reach it."""

MARGIN = 0.1
"""Empty margin around the object, over its size."""

SQUARELY = 0.25
"""Least cosine of the viewing angle of readings that are fused."""

FACES = 20_000
"""Most triangles of the closed surface, like those of a simplified mesh."""

SMOOTHINGS = 10
"""Rounds of smoothing: the visual hull has steps of a cell."""

_THIN = 2  # cells: thinner parts of the visual hull are gaps between outlines


@dataclass(frozen=True, eq=False)
class Fused:
    """vertices, normals (V, 3) object axes; faces (F, 3) int32; seen (V,): measured by a view, not taken
    from the visual hull."""

    vertices: Float64
    normals: Float64
    faces: Int32
    seen: Bool


def fused(views: Sequence[View], closed: bool = False, cells: int = CELLS) -> Fused:
    """The surface that the views show. closed: completed by the visual hull where it was not measured."""
    points = np.concatenate([view.points_obj for view in views])
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    size = float((high - low).max()) * (1 + 2 * MARGIN)
    size = max(size, SMALLEST_CELL_M * cells)
    origin = (low + high) / 2 - size / 2
    cell = size / cells
    distance_m = float(np.median([view.T_cam_obj[2, 3] for view in views]))
    reach = max(3 * cell, 4 * depth_noise_m(distance_m))
    volume = _integrated(views, origin, size, cells, reach)
    if closed:
        _close(volume, views, origin, cell, cells)
    mesh = volume.extract_triangle_mesh()
    mesh = _largest_piece(mesh)
    if closed:
        mesh = mesh.filter_smooth_taubin(SMOOTHINGS).simplify_quadric_decimation(FACES)
    mesh.compute_vertex_normals()
    vertices = np.asarray(mesh.vertices)
    # A vertex was measured if a view confirms it; others come from the visual hull.
    return Fused(
        vertices,
        np.asarray(mesh.vertex_normals),
        np.asarray(mesh.triangles).astype(np.int32),
        votes(vertices, views).there > 0,
    )


def _integrated(views: Sequence[View], origin: Float64, size: float, cells: int, reach: float) -> Any:
    import open3d as o3d

    integration = o3d.pipelines.integration
    image: Any = o3d.geometry.Image  # its stubs know no arrays
    volume = integration.UniformTSDFVolume(
        length=size,
        resolution=cells,
        sdf_trunc=reach,
        color_type=integration.TSDFVolumeColorType.NoColor,
        origin=origin.reshape(3, 1),
    )
    for view in views:
        frame, camera = view.frame, view.frame.camera
        rows, columns = np.indices(frame.depth.shape)
        rays = camera.rays(np.stack([columns, rows], -1))
        cosine = -(view.normals_cam * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
        depth = np.where(view.inner & (cosine > SQUARELY), frame.depth, 0.0).astype(np.float32)
        pair = o3d.geometry.RGBDImage.create_from_color_and_depth(
            image(np.ascontiguousarray(frame.color)),
            image(depth),
            depth_scale=1.0,
            depth_trunc=100.0,
            convert_rgb_to_intensity=False,
        )
        K = o3d.camera.PinholeCameraIntrinsic(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        )
        volume.integrate(pair, K, view.T_cam_obj)
    return volume


def _close(volume: Any, views: Sequence[View], origin: Float64, cell: float, cells: int) -> None:
    """Fill cells without a reading: solid if the object occludes them, and they are neither free space in a
    view nor under the ground, else empty."""
    import open3d as o3d
    from scipy.ndimage import binary_opening

    field = np.asarray(volume.extract_volume_tsdf()).copy()
    index = np.indices((cells,) * 3).reshape(3, -1).T
    centres = origin + (index + 0.5) * cell
    unknown = field[:, 1] == 0
    occluded = np.zeros(len(field), bool)
    left = np.flatnonzero(unknown)
    for view in views:
        vote = votes(centres[left], [view])
        occluded[left] |= vote.behind > 0
        left = left[(vote.through == 0) & (vote.beneath == 0)]
    solid = np.zeros(len(field), bool)
    solid[left] = occluded[left]
    solid = binary_opening((solid | ~unknown).reshape((cells,) * 3), iterations=_THIN).ravel()
    field[unknown, 0] = np.where(solid[unknown], -1.0, 1.0)
    # Empty the cells with readings of things that moved: more views show free space there than the object.
    known = np.flatnonzero(~unknown)
    vote = votes(centres[known], views)
    field[known[vote.through > vote.there + vote.behind], 0] = 1.0
    field[:, 1] = np.maximum(field[:, 1], 1.0)
    at_border = ((index == 0) | (index == cells - 1)).any(1)
    field[at_border, 0] = 1.0
    volume.inject_volume_tsdf(o3d.utility.Vector2dVector(field))


def _largest_piece(mesh: Any) -> Any:
    pieces, counts, _ = mesh.cluster_connected_triangles()
    if len(counts):
        mesh.remove_triangles_by_mask(np.asarray(pieces) != int(np.argmax(counts)))
        mesh.remove_unreferenced_vertices()
    return mesh


SHARPNESS = 6
"""Power of the cosine that weights views: the most frontal views dominate, seams fade over some ten
degrees."""


def painted(shape: Fused, views: Sequence[View]) -> Mesh:
    """The surface with the colours of the views; parts that no view shows have their mean colour."""
    layout = fitting_patches(shape.vertices, shape.faces)
    corners, normals = shape.vertices[shape.faces], shape.normals[shape.faces]
    seen_colors = np.concatenate([view.frame.color[view.inner] for view in views])
    plain = seen_colors.mean(0)
    pictures = [(view, view.frame.color.astype(np.float32)) for view in views]

    def colors(faces: np.ndarray, weights: Float64) -> Float:
        points = np.einsum("fk,fkd->fd", weights, corners[faces])
        normal = np.einsum("fk,fkd->fd", weights, normals[faces])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return _colors(points, normal, pictures, plain)

    texture = layout.baked(colors)
    # Fill the texels between the triangles, because coarser levels of the texture average them in.
    texture = reduced(texture, layout.baked(lambda faces, _: np.ones((len(faces), 3)))[..., 0])
    return Mesh(shape.vertices.astype(np.float32), shape.faces, layout.uv, texture)


def _colors(
    points: Float64, normals: Float64, pictures: Sequence[tuple[View, Float32]], plain: Float64
) -> Float64:
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for view, picture in pictures:
        row, column, z = projected(points, view)
        p = se3.apply(view.T_cam_obj, points)
        cosine = -((normals @ view.T_cam_obj[:3, :3].T) * p).sum(1) / np.linalg.norm(p, axis=1)
        near = np.abs(view.frame.depth[row, column] - z) < tolerance_m(z)
        seen = np.flatnonzero((row >= 0) & view.inner[row, column] & near & (cosine > 0.1))
        w = cosine[seen] ** SHARPNESS / z[seen] ** 2
        total[seen] += w[:, None] * sampled(picture, view.frame.camera.project(p[seen]))
        weight[seen] += w
    known = weight > 0
    out = np.tile(np.asarray(plain, np.float64), (len(points), 1))
    out[known] = total[known] / weight[known, None]
    return out
