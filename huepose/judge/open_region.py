"""Judging without a mask: an open region, a window of a frame in which poses are judged and refined, and the
surface of a model prepared for it. The tracker uses it.

Colours are opponents of single pixels, averaged over the same three lengths on the object as the colours of
the surface samples; light is an offset in them. Coarse averages are computed at lower resolution and
resampled.

The samples of a surface are in random order and the lists of visible samples are increasing, so the first n
of a list cover what is visible evenly: quick scores read few, refinement reads more. `terms_at` judges one
pose in an open region closely, `totals` many quickly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from huepose.colorpair.opponents import opponents_of_bytes
from huepose.geometry.arrays import Float, Float32, Float64, Int32
from huepose.geometry.box import Box
from huepose.geometry.camera import FLOOR_M, NEAR_M, NEAREST_M, Camera, depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.judge.kernel_arrays import NO_LIGHT, ModelArrays, RegionArrays, model_arrays, nearest_view
from huepose.judge.region import least_tolerance_m, saturated
from huepose.judge.silhouette import bounds_of
from huepose.judge.terms import Terms, score_arrays
from huepose.model.types import COLOR_SCALES_M, ReferenceModel
from huepose.support.kept import kept, once_for_each

SCALES_M = (*COLOR_SCALES_M, 0.008)
"""Gaussian sigmas of the three averages on the object; the first two come with a model's surface."""

AROUND_M = (0.008, 0.008, 0.016)
"""Gaussian sigmas of the surroundings of a sample in which the variation of texture is measured, at each of
SCALES_M: the distance that a refinement at that scale may have to bridge. At least the spacing of the samples
is used, which is larger on an object of half a metre: without neighbours nothing would vary."""

MIN_SIDE = 16
"""A window with a shorter side, in pixels, shows too little to be judged."""

REACH_SIGMAS = 2.0
"""Gaussians are cut off at this many sigmas: 4 % of the weight lies beyond."""

BLIND = 0.3
"""Weight of a sample's colour where no depth reading shows whether the object is occluded."""

_NOWHERE = np.array([-2.0, -2.0, -1.0, -1.0])
_NO_POINTS, _NO_WEIGHTS = np.zeros((0, 3)), np.zeros(0)


@dataclass(frozen=True, eq=False)
class OpenRegion:
    """arrays: input of the kernels, colours (3, h, w, 3) at SCALES_M; (x0, y0): top-left pixel of the window
    in the frame."""

    arrays: RegionArrays
    camera: Camera
    x0: int
    y0: int

    def lit(self, light: Float64 | None) -> OpenRegion:
        """A copy with known light (3,), in opponents, or with unknown light (None)."""
        known = light is not None
        arrays = self.arrays._replace(light=NO_LIGHT if light is None else light, lit=known)
        return OpenRegion(arrays, self.camera, self.x0, self.y0)


def window(box: Box, width: int, height: int) -> tuple[int, int, int, int] | None:
    """The window (x0, y0, width, height) of a box in an image of that size, sides in multiples of four
    pixels; None if a side is under 16 pixels."""
    rows, columns = box.slices(width, height)
    w, h = (columns.stop - columns.start) // 4 * 4, (rows.stop - rows.start) // 4 * 4
    return None if w < MIN_SIDE or h < MIN_SIDE else (columns.start, rows.start, w, h)


def open_region(frame: RgbdFrame, box: Box, distance_m: float, diameter_m: float) -> OpenRegion | None:
    """Cut `box` out of a frame for an object of that diameter at that distance, metres; None where (almost)
    none of the box is in the image."""
    cut = window(box, frame.camera.width, frame.camera.height)
    if cut is None:
        return None
    x0, y0, w, h = cut
    color = np.ascontiguousarray(frame.color[y0 : y0 + h, x0 : x0 + w])
    depth = np.ascontiguousarray(frame.depth[y0 : y0 + h, x0 : x0 + w])
    px_per_m = (frame.camera.fx + frame.camera.fy) / 2.0 / max(distance_m, NEAR_M)
    camera = frame.camera.cropped(x0, y0, w, h)
    # As floats: for integers every kernel would be compiled once more.
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    arrays = RegionArrays(
        _NO_POINTS,
        _NO_WEIGHTS,
        0.0,
        depth,
        np.zeros((h, w), np.float32),
        _averaged(opponents_of_bytes(color), px_per_m),
        saturated(color),
        fx,
        fy,
        cx,
        cy,
        _NOWHERE,
        tolerance_m(diameter_m, distance_m),
        blind=BLIND,
    )
    return OpenRegion(arrays, camera, x0, y0)


def tolerance_m(diameter_m: float, distance_m: float) -> float:
    """Tolerance of depth, metres: a reading within it supports the surface. It is the tolerance for the
    object's size, plus twice the noise of a reading above its floor."""
    return least_tolerance_m(diameter_m) + 2.0 * (depth_noise_m(distance_m) - FLOOR_M)


def _averaged(plain: Float32, px_per_m: float) -> Float32:
    """Opponents (3, h, w, 3) averaged over SCALES_M; each scale at a half of the resolution of the one
    before."""
    height, width = plain.shape[:2]
    averages, image = np.empty((len(SCALES_M), height, width, 3), np.float32), plain
    for out, scale_m, step in zip(averages, SCALES_M, (1, 2, 4), strict=True):
        if step > 1:
            size = (width // step, height // step)
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
        # About half a sample of blur is there already, from the lens and from averaging areas.
        sigma = float(np.sqrt(max((scale_m * px_per_m / step) ** 2 - 0.25, 0.16)))
        side = 2 * int(np.ceil(REACH_SIGMAS * sigma)) + 1
        if step == 1:
            cv2.GaussianBlur(image, (side, side), sigma, dst=out)
        else:
            cv2.resize(cv2.GaussianBlur(image, (side, side), sigma), (width, height), dst=out)
    return averages


SAMPLES = 400
"""Surface samples of a close look."""


@dataclass(frozen=True, eq=False)
class PreparedSurface:
    """arrays: input of the kernels, colours as opponents at SCALES_M; steepest (3, N, 3) float32: steepest
    slope of the texture around each sample at each scale, opponents per metre; diameter_m: of the model;
    thickness_m: extent along its thinnest axis; radius_m: of the sphere around the centre that holds all
    samples."""

    arrays: ModelArrays
    steepest: Float32
    diameter_m: float
    thickness_m: float
    radius_m: float

    @staticmethod
    @once_for_each
    def of(model: ReferenceModel) -> PreparedSurface:
        """Prepare a reference model; one surface per model, shared by all callers."""
        arrays = model_arrays(model)
        points = arrays.points
        colors = kept(_Colors, model.digest, lambda: _colors(arrays))
        return PreparedSurface(
            arrays._replace(colors=colors.scales),
            colors.steepest,
            float(model.diameter_m),
            _thickness(points),
            float(np.linalg.norm(points - arrays.centre, axis=1).max()),
        )

    @property
    def middle_obj(self) -> Float64:
        """The object's centre (3,) in its own axes."""
        return self.arrays.centre

    def centre_cam(self, T_cam_obj: Float) -> Float64:
        """The object's centre (3,) in camera axes."""
        return np.asarray(T_cam_obj[:3].dot(self._centre), np.float64)

    @cached_property
    def _centre(self) -> Float64:
        """The centre in object axes, homogeneous (4,): one product with a pose transforms it."""
        return np.append(self.arrays.centre, 1.0)

    @cached_property
    def _every_fourth(self) -> Float32:
        """Every fourth sample (N, 3)."""
        return np.ascontiguousarray(self.arrays.points[::4])

    def view_of(self, T_cam_obj: Float) -> int:
        """The view of the model that is nearest to that of a pose."""
        return int(nearest_view(np.array(T_cam_obj, np.float64, order="C"), self.arrays))

    def shown(self, T_cam_obj: Float, count: int) -> Int32:
        """Indices of up to `count` samples that are visible at a pose, evenly spread."""
        a, view = self.arrays, self.view_of(T_cam_obj)
        return a.visible[a.offsets[view] : a.offsets[view + 1]][:count]

    def box(self, T_cam_obj: Float, camera: Camera) -> Box | None:
        """Bounds of the object in the image, not clipped to it, from every fourth sample. Samples that are
        not ahead of the camera are left out; None if these are more than half, or if the object's centre is
        among them."""
        points = self._every_fourth
        T = np.ascontiguousarray(T_cam_obj, dtype=np.float64)
        ahead, left, top, right, bottom = bounds_of(
            points, T, camera.fx, camera.fy, camera.cx, camera.cy, NEAREST_M
        )
        if ahead < len(points) and (2 * ahead < len(points) or self.centre_cam(T)[2] < NEAREST_M):
            return None
        return Box(left, top, right - left, bottom - top)


@dataclass(frozen=True, eq=False)
class _Colors:
    """scales (3, N, 3) float32: opponents of the samples at SCALES_M; steepest as in `PreparedSurface`."""

    scales: Float32
    steepest: Float32


def _colors(arrays: ModelArrays) -> _Colors:
    points, normals, given = arrays.points, arrays.normals, arrays.colors[:2]
    further = float(np.sqrt(SCALES_M[2] ** 2 - SCALES_M[1] ** 2))
    coarse = _averaged_around(points, normals, given[1], further)
    scales = np.ascontiguousarray(np.concatenate([given, coarse[None]]), np.float32)
    return _Colors(scales, steepest(points, normals, scales))


def steepest(points: Float32, normals: Float32, scales: Float32) -> Float32:
    """Steepest slopes (3, N, 3) of the texture around each of N samples at each of SCALES_M, in units of
    `scales` (3, N, 3) per metre. Over its averaging length, texture changes by no more than its standard
    deviation."""
    out = np.empty(scales.shape, np.float32)
    around = np.maximum(AROUND_M, _spacing(points))
    for slope, colors, scale_m, around_m in zip(
        out, scales.astype(np.float64), SCALES_M, around.tolist(), strict=True
    ):
        both = _averaged_around(points, normals, np.concatenate([colors, colors**2], axis=1), around_m)
        slope[:] = np.sqrt(np.maximum(both[:, 3:] - both[:, :3] ** 2, 0.0)) / scale_m
    return out


def _spacing(points: Float32) -> float:
    """Median distance of points (N, 3) from their nearest neighbours, metres."""
    from scipy.spatial import cKDTree

    nearest, _ = cKDTree(points).query(points, k=2)
    return float(np.median(nearest[:, 1]))


def _thickness(points: Float32) -> float:
    """Extent of the points along the axis in which they spread least, metres."""
    q = points - points.mean(0)
    along = q @ np.linalg.eigh((q.T @ q).astype(np.float64))[1][:, 0]
    return float(np.ptp(along))


def _averaged_around(points: Float32, normals: Float32, values: Float, sigma_m: float) -> Float64:
    """Values (N, K) averaged by a Gaussian over neighbours that face the same way."""
    from scipy.spatial import cKDTree  # 0.2 s, which a tracker of cached objects saves

    a, b = cKDTree(points).query_pairs(2.5 * sigma_m, output_type="ndarray").T
    x, y, z = ((column[a] - column[b]) ** 2 for column in points.T.copy())
    nx, ny, nz = (column[a] * column[b] for column in normals.T.copy())
    near = np.exp(-(x + y + z) / (2 * sigma_m**2)) * np.maximum(nx + ny + nz, 0.0)
    own = np.arange(len(points))
    i, j = np.concatenate([a, b, own]), np.concatenate([b, a, own])
    w = np.concatenate([near, near, (normals**2).sum(1)])
    total = np.bincount(i, w, len(points))
    return np.stack([np.bincount(i, w * column[j], len(points)) / total for column in values.T.copy()], 1)


def terms_at(surface: PreparedSurface, region: OpenRegion, *poses: Float64) -> list[Terms]:
    """The terms of each of some poses (4, 4), from up to SAMPLES samples."""
    return [Terms.of(row) for row in score_arrays(surface.arrays, region.arrays, np.array(poses), SAMPLES)]


def totals(
    surface: PreparedSurface,
    region: OpenRegion,
    poses: Float64,
    samples: int,
    tolerance_m: float | None = None,
) -> Float64:
    """Totals (K,) of poses (K, 4, 4) by few samples and the coarser colours, which have wide basins of
    convergence."""
    arrays = region.arrays._replace(finest=1)
    if tolerance_m is not None:
        arrays = arrays._replace(tolerance=tolerance_m)
    return np.asarray(score_arrays(surface.arrays, arrays, poses, samples)[:, 0])
