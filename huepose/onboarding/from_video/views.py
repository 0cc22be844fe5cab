"""Keyframes (views), and what their depth images say about points of the object.

Everything that is not the object moves relative to it. So a point is rejected if another view shows a
free-space violation there, or something else in its place. This one test removes hands, tables and flying
pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64, Int64
from huepose.geometry.box import Box
from huepose.geometry.camera import FLOOR_M, NEAREST_M, STEREO_NOISE_PER_M
from huepose.geometry.frame import RgbdFrame
from huepose.judge.open_region import open_region
from huepose.onboarding.from_video.sight import SIGMAS, tally

FACET_M = 0.006
"""Half the width of the patch of readings that gives a normal; noise of some millimetres needs this."""

_WITHOUT_POSE = ("inner", "outer", "nearest", "normals_cam", "points_cam")

RIM_PX = 2
"""Width of the border of a mask that is not used: depth and colour are mixed there."""


@dataclass(frozen=True, eq=False)
class View:
    """A crop of a frame around the object. mask (H, W): pixels of the object; denied (H, W): pixels that
    are certainly not the object; the rest is unknown. T_cam_obj (4, 4). ground (4,): the plane under the
    object, normal towards the camera and offset, camera axes; None if it is not visible."""

    frame: RgbdFrame
    mask: Bool
    denied: Bool
    T_cam_obj: Float64
    ground: Float64 | None

    def at(self, T_cam_obj: Float64) -> View:
        """The same view with another pose of the object."""
        out = replace(self, T_cam_obj=T_cam_obj)
        # Properties that do not depend on the pose stay cached.
        out.__dict__.update({name: self.__dict__[name] for name in _WITHOUT_POSE if name in self.__dict__})
        return out

    @property
    def camera_at(self) -> tuple[Float64, Float64]:
        """The pose and fx, fy, cx, cy of the camera, as the kernels of `sight` take them."""
        return np.ascontiguousarray(self.T_cam_obj), self.frame.camera.lens

    @cached_property
    def inner(self) -> Bool:
        """The mask without its border."""
        return eroded(self.mask)

    @cached_property
    def outer(self) -> Bool:
        """The denied pixels without their border."""
        return eroded(self.denied)

    @cached_property
    def nearest(self) -> Float32:
        """Least depth (H, W) of each pixel and its neighbours, so that a point less than a pixel beside an
        outline is not a free-space violation; 0 without a reading."""
        known = np.where(self.frame.depth > 0, self.frame.depth, np.float32(np.inf))
        least = np.asarray(cv2.erode(known, np.ones((3, 3), np.uint8)), np.float32)
        return np.where(self.frame.depth > 0, least, np.float32(0))

    @cached_property
    def normals_cam(self) -> Float32:
        """Normals (H, W, 3) of the mask, towards the camera; zero outside of it."""
        return normals_cam(self.frame, self.mask)

    @cached_property
    def opponents(self) -> Float32:
        """Opponent colours (3, H, W, 3), averaged over three lengths on the object."""
        camera, distance_m = self.frame.camera, float(self.T_cam_obj[2, 3])
        region = open_region(self.frame, Box(0, 0, camera.width, camera.height), distance_m, 0.1)
        assert region is not None  # the crop contains the object
        colors = region.arrays.colors
        missing = (camera.height - colors.shape[1], camera.width - colors.shape[2])
        return np.pad(colors, ((0, 0), (0, missing[0]), (0, missing[1]), (0, 0)), mode="edge")

    @cached_property
    def points_cam(self) -> Float64:
        """Points (N, 3), camera axes, of the inner pixels."""
        rows, columns = np.nonzero(self.inner)
        return self.frame.camera.backproject(np.stack([columns, rows], 1), self.frame.depth[rows, columns])

    @property
    def points_obj(self) -> Float64:
        """`points_cam` in the object's axes."""
        return se3.apply(se3.inverse(self.T_cam_obj), self.points_cam)


class Votes(NamedTuple):
    """Number of views (N,) that say of each point: the object is there; it is free space (depth is measured
    behind it); something else is there; the object occludes it; it is under the ground. The order is that
    of `sight.tally`."""

    there: Int64
    through: Int64
    other: Int64
    behind: Int64
    beneath: Int64


def votes(points_obj: Float, views: Sequence[View]) -> Votes:
    """The votes of the views on points (N, 3)."""
    points, counts = np.ascontiguousarray(points_obj, np.float64), np.zeros((len(points_obj), 5), np.int64)
    for view in views:
        ground = np.zeros(4) if view.ground is None else view.ground
        depth = view.frame.depth
        tally(points, *view.camera_at, depth, view.mask, view.outer, view.nearest, ground, counts)
    return Votes(*counts.T)


def projected(points_obj: Float, view: View) -> tuple[Int64, Int64, Float64]:
    """Rows and columns (N,) of points (N, 3) in a view, -1 outside, and their depths (N,)."""
    camera, p = view.frame.camera, se3.apply(view.T_cam_obj, points_obj)
    z = np.maximum(p[:, 2], 1e-6)
    column = np.rint(p[:, 0] / z * camera.fx + camera.cx)
    row = np.rint(p[:, 1] / z * camera.fy + camera.cy)
    inside = (
        (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height) & (p[:, 2] > NEAREST_M)
    )
    return np.where(inside, row, -1).astype(np.int64), np.where(inside, column, -1).astype(np.int64), p[:, 2]


def tolerance_m(distance_m: Float | float) -> Float64:
    """Largest difference, metres, between readings of one surface at distances (N,)."""
    square = np.square(np.asarray(distance_m, np.float64))
    return np.asarray(SIGMAS * (FLOOR_M + STEREO_NOISE_PER_M * square))


def eroded(mask: Bool) -> Bool:
    """A mask without its border; the image border does not count as one."""
    kernel = np.ones((2 * RIM_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel) > 0)


def normals_cam(frame: RgbdFrame, mask: Bool) -> Float32:
    """Normals (H, W, 3) of planes that are fitted to the masked readings around each pixel; zero elsewhere.

    The inverse depth of a plane is linear in the image, so a few box filters fit all planes."""
    known = mask & (frame.depth > 0)
    if not known.any():
        return np.zeros((*mask.shape, 3), np.float32)
    camera = frame.camera
    radius = max(2, round(FACET_M * camera.fx / float(np.median(frame.depth[known]))))
    rows, columns = np.indices(mask.shape)
    x = np.asarray((columns - camera.cx) / camera.fx, np.float64)
    y = np.asarray((rows - camera.cy) / camera.fy, np.float64)
    inverse = np.where(known, 1.0 / np.maximum(frame.depth, 1e-3), 0.0).astype(np.float64)
    basis: list[Float64] = [x, y, np.ones_like(x)]

    def total(values: Float64) -> Float64:
        size = (2 * radius + 1,) * 2
        return np.asarray(cv2.boxFilter(values, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT))

    A, b = np.empty((*mask.shape, 3, 3)), np.empty((*mask.shape, 3))
    for i, p in enumerate(basis):
        b[..., i] = total(p * inverse)
        for j, q in enumerate(basis):
            A[..., i, j] = total(p * q * known)
    plane = np.linalg.solve(A[known] + 1e-12 * np.eye(3), b[known][..., None])[..., 0]
    out = np.zeros((*mask.shape, 3), np.float32)
    out[known] = -plane / np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-12)
    return out
