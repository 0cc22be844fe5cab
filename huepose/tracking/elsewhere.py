"""Finds the most probable place of a lost object in the whole image, without a prior position.

View codes (`propose.view_codes`) of windows of the object's size give position and rotation; the tracker's
own search continues from there.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.geometry.frame import RgbdFrame
from huepose.geometry.suppression import first_different
from huepose.model.types import ReferenceModel
from huepose.perception.clear_view import clear_view
from huepose.perception.filled import filled
from huepose.perception.window_table import WindowTable, compared, most_similar_views, promising
from huepose.perception.windows import Windows
from huepose.tracking.motion import Reach

WINDOWS, PARTS = 8, 5
"""Windows that are compared at once, those with the best hues first, and the number of such parts. In
rendered sequences the object is at the best place of the first eight windows in 99 of 100 frames."""

MOST_PIXELS = 120_000
"""A window has 64 pixels a side, so the image needs no more pixels than this."""

LOOKS_EACH = 6
"""Most views per window."""

SAME_PLACE = 0.35
"""Views whose centres are within this share of the diameter belong to one place."""

TURNS, APART = 2, np.radians(17.0)
"""Number of rotations that are taken from the views at the most probable place, and their least difference:
half of that between views."""

NEAR, NEAR_TURN = 0.3, np.radians(18.0)
"""The object is within this distance, in diameters, of a window's middle, and within this rotation of the
most similar view."""


def likeliest_place(
    model: ReferenceModel, table: WindowTable, frame: RgbdFrame, part: int = 0
) -> Reach | None:
    """The place and rotations of highest likeness in one part of the windows; None if no window shows
    anything."""
    view = clear_view(_smaller(filled(frame)), model.diameter_m)
    if view is None:
        return None
    windows = Windows(view, model.diameter_m)
    some = promising(table, windows)[part * WINDOWS : (part + 1) * WINDOWS]
    if not len(some):
        return None
    alike = compared(table, windows, some)
    poses = most_similar_views(
        table, windows, some, alike, view.crop.camera, WINDOWS * LOOKS_EACH, LOOKS_EACH
    ).poses
    centres = poses[:, :3, :3] @ model.mesh.centre + poses[:, :3, 3]
    here = np.linalg.norm(centres - centres[0], axis=1) < SAME_PLACE * model.diameter_m
    middle = np.asarray(np.median(centres[here], axis=0), np.float64)
    turns = poses[here][first_different(poses[here], APART, TURNS), :3, :3]
    return Reach(middle, tuple(turns), NEAR * model.diameter_m, NEAR_TURN)


def _smaller(frame: RgbdFrame) -> RgbdFrame:
    """A frame scaled down by halves until it has few enough pixels."""
    camera = frame.camera
    while camera.width * camera.height > MOST_PIXELS:
        camera = camera.scaled(0.5)
    if camera is frame.camera:
        return frame
    size = camera.width, camera.height
    color = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
    depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)
    return replace(frame, color=np.asarray(color), depth=np.asarray(depth), camera=camera)
