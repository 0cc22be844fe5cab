"""The surface samples of a reference model with colours at three scales, for open regions (without mask).

The samples are in random order and the lists of visible samples are increasing, so the first n of a list
cover what is visible evenly: quick scores read few, refinement reads more. `look` judges one pose in an open
region closely, `totals` many quickly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64, Int32
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAREST_M, Camera
from huepose.judge.open_region import SCALES_M, OpenRegion
from huepose.judge.region import ModelArrays, model_arrays
from huepose.judge.silhouette import bounds_of
from huepose.judge.terms import Terms, score_arrays
from huepose.model.types import ReferenceModel
from huepose.support.kept import kept

SAMPLES = 400
"""Surface samples of a close look."""


@dataclass(frozen=True, eq=False)
class PreparedSurface:
    """arrays: input of the kernels, colours as opponents at SCALES_M; diameter_m: of the model; thickness_m:
    extent along its thinnest axis; radius_m: of the sphere around the centre that holds all samples."""

    arrays: ModelArrays
    diameter_m: float
    thickness_m: float
    radius_m: float

    @staticmethod
    def of(model: ReferenceModel) -> PreparedSurface:
        """Prepare a reference model."""
        arrays = model_arrays(model)
        points = arrays.points
        return PreparedSurface(
            arrays._replace(colors=kept(_Colors, model.digest, lambda: _colors(arrays)).scales),
            float(model.diameter_m),
            _thickness(points),
            float(np.linalg.norm(points - arrays.centre, axis=1).max()),
        )

    def centre_cam(self, T_cam_obj: Float) -> Float64:
        """The object's centre (3,) in camera axes."""
        return np.asarray(T_cam_obj[:3, :3] @ self.arrays.centre + T_cam_obj[:3, 3], np.float64)

    def view_of(self, T_cam_obj: Float) -> int:
        """The view of the model that is nearest to that of a pose."""
        eye = T_cam_obj[:3, :3].T @ -self.centre_cam(T_cam_obj)
        return int(np.argmax(self.arrays.directions @ eye.astype(np.float32)))

    def shown(self, T_cam_obj: Float, count: int) -> Int32:
        """Indices of up to `count` samples that are visible at a pose, evenly spread."""
        a, view = self.arrays, self.view_of(T_cam_obj)
        return a.visible[a.offsets[view] : a.offsets[view + 1]][:count]

    def box(self, T_cam_obj: Float, camera: Camera) -> Box | None:
        """Bounds of the object in the image, from every fourth sample; None when it reaches behind the
        camera. Not clipped to the image."""
        points = np.ascontiguousarray(self.arrays.points[::4])
        T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
        ahead, left, top, right, bottom = bounds_of(
            points, T, camera.fx, camera.fy, camera.cx, camera.cy, NEAREST_M
        )
        return Box(left, top, right - left, bottom - top) if ahead == len(points) else None


@dataclass(frozen=True, eq=False)
class _Colors:
    """scales (3, N, 3) float32: opponents of the samples at SCALES_M."""

    scales: Float32


def _colors(arrays: ModelArrays) -> _Colors:
    colors = arrays.colors
    coarse = _averaged(arrays.points, arrays.normals, colors[1], SCALES_M[1], SCALES_M[2])
    return _Colors(np.ascontiguousarray(np.concatenate([colors[:2], coarse[None]])))


def _thickness(points: Float32) -> float:
    """Extent of the points along the axis in which they spread least, metres."""
    q = points - points.mean(0)
    along = q @ np.linalg.eigh((q.T @ q).astype(np.float64))[1][:, 0]
    return float(np.ptp(along))


def _averaged(points: Float32, normals: Float32, colors: Float32, have_m: float, want_m: float) -> Float32:
    """Colours (N, 3) averaged further over neighbours that face the same way, from one sigma to a larger
    one."""
    from scipy.spatial import cKDTree  # a fifth of a second, which no tracker of known objects needs

    sigma = float(np.sqrt(want_m**2 - have_m**2))
    pairs = cKDTree(points).query_pairs(2.5 * sigma, output_type="ndarray")
    own = np.arange(len(points))
    i, j = np.concatenate([pairs[:, 0], pairs[:, 1], own]), np.concatenate([pairs[:, 1], pairs[:, 0], own])
    d2 = ((points[i] - points[j]) ** 2).sum(1)
    w = np.exp(-d2 / (2 * sigma**2)) * np.maximum((normals[i] * normals[j]).sum(1), 0.0)
    total = np.bincount(i, w, len(points))
    return np.stack([np.bincount(i, w * colors[j, c], len(points)) / total for c in range(3)], 1).astype(
        np.float32
    )


def look(surface: PreparedSurface, region: OpenRegion, T_cam_obj: Float64) -> Terms:
    """The terms of a pose T_cam_obj (4, 4), from up to SAMPLES samples."""
    terms = score_arrays(surface.arrays, region.arrays, np.asarray(T_cam_obj)[None], SAMPLES)[0]
    return Terms(*(float(x) for x in terms))


def totals(
    surface: PreparedSurface,
    region: OpenRegion,
    poses: Float64,
    samples: int,
    tolerance_m: float | None = None,
) -> Float64:
    """Totals (K,) of poses (K, 4, 4) by few samples and the coarser colours, which have wide basins of
    convergence."""
    arrays = region.blunt()
    if tolerance_m is not None:
        arrays = arrays._replace(tolerance=tolerance_m)
    return np.asarray(score_arrays(surface.arrays, arrays, poses, samples)[:, 0])
