"""Finds the place in the whole picture that looks most like a lost object, without a prior position.

View codes (`propose.view_codes`) of windows of the object's size give place and rotation; the tracker's own
search continues from there.
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
from huepose.perception.window_table import WindowTable, compared, likest_views, promising
from huepose.perception.windows import Windows
from huepose.tracking.motion import Reach

WINDOWS, PARTS = 8, 5
"""Windows that are looked at in one go, the likeliest by hue first, and how often as many more of them are.
On drawn films the object is at the likeliest of the first eight in 99 of 100 frames."""

MOST_PIXELS = 120_000
"""A window has 64 pixels a side, and the picture no need of more than that many for it."""

LOOKS_EACH = 6
"""Views that a window may show."""

SAME_PLACE = 0.35
"""Views whose centres lie within this share of the diameter are of one place."""

TURNS, APART = 2, np.radians(17.0)
"""So many of the turns of the views at the likeliest place are taken, this far apart: half of what is between
views."""

NEAR, NEAR_TURN = 0.3, np.radians(18.0)
"""From a window's middle and the view that it is like, the object is not farther off: in diameters, in
radians."""


def likeliest_place(
    model: ReferenceModel, table: WindowTable, frame: RgbdFrame, part: int = 0
) -> Reach | None:
    """The place and rotations of highest similarity among one part of the windows; None if nothing stands
    there."""
    view = clear_view(_smaller(filled(frame)), model.diameter_m)
    if view is None:
        return None
    windows = Windows(view, model.diameter_m)
    some = promising(table, windows)[part * WINDOWS : (part + 1) * WINDOWS]
    if not len(some):
        return None
    alike = compared(table, windows, some)
    poses = likest_views(
        table, windows, some, alike, view.crop.camera, WINDOWS * LOOKS_EACH, LOOKS_EACH
    ).poses
    centres = poses[:, :3, :3] @ model.mesh.centre + poses[:, :3, 3]
    here = np.linalg.norm(centres - centres[0], axis=1) < SAME_PLACE * model.diameter_m
    middle = np.asarray(np.median(centres[here], axis=0), np.float64)
    turns = poses[here][first_different(poses[here], APART, TURNS), :3, :3]
    return Reach(middle, tuple(turns), NEAR * model.diameter_m, NEAR_TURN)


def _smaller(frame: RgbdFrame) -> RgbdFrame:
    """A frame halved until it has few enough pixels."""
    camera = frame.camera
    while camera.width * camera.height > MOST_PIXELS:
        camera = camera.scaled(0.5)
    if camera is frame.camera:
        return frame
    size = camera.width, camera.height
    color = cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA)
    depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)
    return replace(frame, color=np.asarray(color), depth=np.asarray(depth), camera=camera)
