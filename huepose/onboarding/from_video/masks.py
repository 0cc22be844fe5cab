"""Segment the object in a frame, given its pose and other views."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.onboarding.from_video.selection import connected_surfaces, on_ground
from huepose.onboarding.from_video.views import View, votes

STEP_M = 0.008
"""Distance by which a mask may grow into surface that no view has measured, besides what a rotation
uncovers."""

_SEEN_GROUND = 0.05  # least share of a crop in which the ground counts as visible
_SUPPORT = 0.2  # least share of a connected surface that other views confirm; others only touch the object


def window_of(frame: RgbdFrame, T_cam_obj: Float64, radius_m: float) -> tuple[slice, slice] | None:
    """Rows and columns of the crop around a ball of this radius about the object's origin, with sides in
    multiples of four pixels; None if it is outside, or too small."""
    x, y, z = T_cam_obj[:3, 3]
    if z <= radius_m:
        return None
    camera = frame.camera
    u, v = x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy
    half_u, half_v = radius_m / z * camera.fx, radius_m / z * camera.fy
    left, top = max(0, int(u - half_u)), max(0, int(v - half_v))
    width = (min(camera.width, int(u + half_u)) - left) // 4 * 4
    height = (min(camera.height, int(v + half_v)) - top) // 4 * 4
    return None if min(width, height) < 32 else (slice(top, top + height), slice(left, left + width))


def cut(frame: RgbdFrame, rows: slice, columns: slice) -> RgbdFrame:
    """A crop of a frame."""
    height, width = rows.stop - rows.start, columns.stop - columns.start
    return RgbdFrame(
        np.ascontiguousarray(frame.color[rows, columns]),
        np.ascontiguousarray(frame.depth[rows, columns]),
        frame.camera.cropped(columns.start, rows.start, width, height),
        frame.frame_id,
        frame.stamp_ns,
    )


def view_at(
    frame: RgbdFrame, T_cam_obj: Float64, views: Sequence[View], ground: Float64 | None, radius_m: float
) -> View | None:
    """The view of the object in a frame at a pose, with a mask by what other views say; None if it shows
    nothing of the object. radius_m: of the object, as far as it is known."""
    window = window_of(frame, T_cam_obj, 1.6 * radius_m)
    if window is None:
        return None
    part = cut(frame, *window)
    mask, denied = object_mask(part, T_cam_obj, views, ground, radius_m)
    if not mask.any():
        return None
    return View(part, mask, denied, T_cam_obj, ground if ground is not None and shows(part, ground) else None)


def shows(part: RgbdFrame, ground: Float64) -> bool:
    """Whether the ground is visible in a crop. It is not if the camera has moved, or the ground is not in
    view."""
    return bool(on_ground(part, ground).sum() > _SEEN_GROUND * part.depth.size)


def object_mask(
    part: RgbdFrame, T_cam_obj: Float64, views: Sequence[View], ground: Float64 | None, radius_m: float
) -> tuple[Bool, Bool]:
    """Pixels (H, W) that are the object: connected to surface that other views confirm, and denied by none;
    and pixels that are not: the ground, and what other views deny."""
    standing = part.depth > 0
    if ground is not None and shows(part, ground):
        standing &= ~on_ground(part, ground)
    rows, columns = np.nonzero(standing)
    points = part.camera.backproject(np.stack([columns, rows], 1), part.depth[rows, columns])
    vote = votes(se3.apply(se3.inverse(T_cam_obj), points), views)
    confirmed, possible, denied = np.zeros((3, *part.depth.shape), bool)
    confirmed[rows, columns] = (vote.there > vote.through) & (vote.there >= vote.other)
    possible[rows, columns] = (vote.there + vote.through + vote.other == 0) | confirmed[rows, columns]
    denied[part.depth > 0] = True
    denied &= ~possible
    turned = min(se3.rotation_angle(view.T_cam_obj[:3, :3], T_cam_obj[:3, :3]) for view in views)
    reach_m = STEP_M + radius_m * min(np.sin(min(turned, np.pi / 2)), 0.5)
    reach = max(1, round(reach_m * part.camera.fx / max(float(T_cam_obj[2, 3]), 0.05)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    possible &= cv2.dilate(confirmed.astype(np.uint8), disc) > 0
    number, surfaces = connected_surfaces(part.depth, possible)
    sizes = np.bincount(surfaces.ravel(), minlength=number)
    support = np.bincount(surfaces[confirmed], minlength=number)
    belongs = support > np.maximum(_SUPPORT * sizes, 20)
    belongs[0] = False
    mask = cv2.morphologyEx(belongs[surfaces].astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(mask > 0), denied
