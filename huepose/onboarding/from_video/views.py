"""Keyframes (views), and what their depth images say about points of the object.

Everything that is not the object moves relative to it. So a point is rejected if another view sees through it
or sees something else in its place. This one test removes hands, tables and flying pixels.
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
"""Half the width of the patch whose readings give a normal: several millimetres of noise need as many."""

_OF_THE_PICTURE = ("inner", "outer", "nearest", "normals_cam", "points_cam")

RIM_PX = 2
"""At the border of a mask depth and colour are mixed: what is there is not known."""


@dataclass(frozen=True, eq=False)
class View:
    """A frame's window about the object. mask (H, W): pixels of the object; denied (H, W): of what is not;
    the others are not known; T_cam_obj (4, 4); ground (4,): the plane that carries it, normal towards the
    camera and offset, camera axes, None where none is seen."""

    frame: RgbdFrame
    mask: Bool
    denied: Bool
    T_cam_obj: Float64
    ground: Float64 | None

    def at(self, T_cam_obj: Float64) -> View:
        """The same view from another pose."""
        out = replace(self, T_cam_obj=T_cam_obj)
        # What is known of the picture alone stays known.
        out.__dict__.update({name: self.__dict__[name] for name in _OF_THE_PICTURE if name in self.__dict__})
        return out

    @property
    def camera_at(self) -> tuple[Float64, Float64]:
        """Its pose and its camera's fx, fy, cx, cy, as the loops of `sight` take them."""
        return np.ascontiguousarray(self.T_cam_obj), self.frame.camera.lens

    @cached_property
    def inner(self) -> Bool:
        """The mask less its rim."""
        return eroded(self.mask)

    @cached_property
    def outer(self) -> Bool:
        """What is not the object, less its rim."""
        return eroded(self.denied)

    @cached_property
    def nearest(self) -> Float32:
        """Depth (H, W) of the nearest of each pixel and its neighbours: what lies beside an outline by less
        than a pixel is not seen through; 0 without a reading."""
        known = np.where(self.frame.depth > 0, self.frame.depth, np.float32(np.inf))
        least = np.asarray(cv2.erode(known, np.ones((3, 3), np.uint8)), np.float32)
        return np.where(self.frame.depth > 0, least, np.float32(0))

    @cached_property
    def normals_cam(self) -> Float32:
        """Normals (H, W, 3) of the mask, towards the camera; zero where there is none."""
        return normals_cam(self.frame, self.mask)

    @cached_property
    def opponents(self) -> Float32:
        """Colours (3, H, W, 3) averaged over three lengths on the object."""
        camera, distance_m = self.frame.camera, float(self.T_cam_obj[2, 3])
        region = open_region(self.frame, Box(0, 0, camera.width, camera.height), distance_m, 0.1)
        assert region is not None  # a window about an object
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
        """The same in the object's axes."""
        return se3.apply(se3.inverse(self.T_cam_obj), self.points_cam)


class Votes(NamedTuple):
    """How many views say of points (N,) that: the object is there; they see through it; something else is
    there; the object is before it; it is under the ground. In the order of `sight.tally`."""

    there: Int64
    through: Int64
    other: Int64
    behind: Int64
    beneath: Int64


def votes(points_obj: Float, views: Sequence[View]) -> Votes:
    """What views say of points (N, 3)."""
    points, said = np.ascontiguousarray(points_obj, np.float64), np.zeros((len(points_obj), 5), np.int64)
    for view in views:
        ground = np.zeros(4) if view.ground is None else view.ground
        depth = view.frame.depth
        tally(points, *view.camera_at, depth, view.mask, view.outer, view.nearest, ground, said)
    return Votes(*said.T)


def projected(points_obj: Float, view: View) -> tuple[Int64, Int64, Float64]:
    """Rows and columns (N,) of points (N, 3) in a view, -1 outside, and their distances along its axis."""
    camera, p = view.frame.camera, se3.apply(view.T_cam_obj, points_obj)
    z = np.maximum(p[:, 2], 1e-6)
    column = np.rint(p[:, 0] / z * camera.fx + camera.cx)
    row = np.rint(p[:, 1] / z * camera.fy + camera.cy)
    inside = (
        (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height) & (p[:, 2] > NEAREST_M)
    )
    return np.where(inside, row, -1).astype(np.int64), np.where(inside, column, -1).astype(np.int64), p[:, 2]


def tolerance_m(distance_m: Float | float) -> Float64:
    """How far readings of one surface at distances (N,) may lie apart."""
    square = np.square(np.asarray(distance_m, np.float64))
    return np.asarray(SIGMAS * (FLOOR_M + STEREO_NOISE_PER_M * square))


def eroded(mask: Bool) -> Bool:
    """A mask less its rim; the picture's border is none."""
    kernel = np.ones((2 * RIM_PX + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(mask.astype(np.uint8), kernel) > 0)


def normals_cam(frame: RgbdFrame, mask: Bool) -> Float32:
    """Normals (H, W, 3) by planes through the masked readings around each pixel; zero elsewhere.

    The inverse depth of a plane is linear in the picture, so a few box filters fit all of them."""
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
