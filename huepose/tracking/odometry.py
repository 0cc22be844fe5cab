"""Visual odometry: the motion of the camera, measured from its pictures where no pose of it is given.

Corners of a keyframe, with their depth, are followed from picture to picture (Lucas and Kanade, pyramidal,
forward and back); the pose of the camera is the one that most of them agree on (EPnP in RANSAC, then least
squares). A camera stands as long as half of the corners are where they were in the keyframe, so one at rest
does not drift. If the motion cannot be measured, the camera is taken to have stood.

Nothing of this is done for a camera that moves slowly: a track follows what is seen to move by little just as
well. How far the whole picture moves is told by phase correlation of two thumbnails. That is also where the
corners are first looked for.

Constants that say nothing else were chosen on films of `studies.on_hand` (seeds 924 and 904) and on the
built-in scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M, Camera
from huepose.geometry.frame import RgbdFrame

THUMBNAIL_PX, FAST, CALM_S = 80, 1 / 160, 1.0
"""Width of a thumbnail; the least shift of a picture from frame to frame, as a share of its width, of a
camera that moves fast (4 of 640 pixels, some 10 degrees a second at 30 Hz); and for how long its motion is
measured then. Three films of a camera on a hand move by 8 to 13 pixels in the median, the built-in scene by
3.3 at most."""

WIDTH_PX = 320
"""Corners are followed in pictures of this width, or of a camera's own if that is less."""

CORNERS, APART_PX, WORST = 300, 7, 0.01
"""Most corners of a keyframe, their least distance, and the least strength of one as a share of the best."""

WINDOW_PX, LEVELS = 15, 4
"""Of Lucas and Kanade: side of a window, and levels of the pyramids: corners are found again up to some
hundred pixels off."""

PROBES, CELL_PX, STANDS_PX, STILL_SHARE = 40, 40, 0.12, 0.5
"""The camera stands if, of so many corners, spread over cells of the picture, that share is no farther than
this from where it was in the keyframe. What moves before a camera at rest seldom covers so many."""

MOVED_PX, EXPLAINED = 0.3, 0.6
"""A corner that has moved by more than this must be so much more alike there than where it was: else it is
noise that is followed. Of the difference 0.04 to 0.2 are left where a camera on a hand moves (six films), and
0.85 to 0.89 before a smooth wall."""

OFF_PX = 0.75
"""Most that a corner may lie off where the pose puts it, or where it is followed back to."""

FEWEST, MAJORITY = 25, 0.5
"""Corners that have to agree on a motion, and their share of those that were found again."""

VOTE, FEWEST_OF_ROOM = 3, 10
"""A part of the picture stands if so many of its corners do, and the share of them with which the camera
does; else it agrees with a motion if as many do, and the share that has to. The parts are tracked objects and
the room, what lies outside of them. The room has to agree, or if it has fewer corners than the last, two
objects; and no more objects may stand than agree: else something large passes before a camera at rest."""

BESIDE_PX = 5.0
"""So far outside of its box a corner may be an object's outline."""

SILENT_S = 1.0
"""So long after the last pose that was told nobody tells any more: a robot tells ten a second, or misses
some."""

WORN = 0.9
"""A new keyframe is begun where less than this share of a keyframe's corners is left: what is followed from
picture to picture drifts."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """grey (h, w): the picture; points (N, 3): corners in its camera's axes, metres; pixels (N, 2), strongest
    first; probes (P,): those that tell whether the camera stands; T_room_cam (4, 4)."""

    grey: UInt8
    points: Float64
    pixels: Float32
    probes: Int64
    T_room_cam: Float64


@dataclass(frozen=True, eq=False)
class Seen:
    """The last picture, in grey (h, w); alive (N,): the corners of the keyframe that are followed in it, by
    their indices; pixels (N, 2): where they are."""

    grey: UInt8
    alive: Int64
    pixels: Float32

    @staticmethod
    def as_in(key: Keyframe, grey: UInt8) -> Seen:
        """A picture in which all corners are where they are in the keyframe."""
        return Seen(grey, np.arange(len(key.pixels)), key.pixels)


class Odometry:
    """Where one camera is, frame by frame: where it is told to be, else, if `on`, where it is measured to be,
    in the axes of what came first. What is told after it was measured is taken to these axes.

    Single frames of which nobody tells it have no place: what is told next says better how it moved. It is
    measured meanwhile, so that its place is known where nobody tells any more (`SILENT_S`)."""

    def __init__(self, on: bool = True) -> None:
        self._on = on
        self._T_room_parent: Float64 | None = None
        self._told_ns: int | None = None
        self._before: RgbdFrame | None = None
        self._fast_ns: int | None = None
        self._followed: tuple[Keyframe, Seen] | None = None
        self._T_room_cam: Float64 = np.eye(4)

    def placed(self, frame: RgbdFrame, objects: Callable[[], Sequence[Box]]) -> RgbdFrame:
        """The next frame from where its camera was. objects: gives the boxes of tracked objects in the frame
        before."""
        if not self._on:
            return frame
        told, told_ns = frame.T_parent_cam, self._told_ns
        silent = told_ns is None or not 0 <= frame.stamp_ns - told_ns <= SILENT_S * 1e9
        if told is None or silent:
            self._go_on(frame, objects)
        if told is None:
            self._before = frame.seen_from(self._T_room_cam)
            return self._before if silent else frame
        if silent and self._before is not None:
            self._T_room_parent = se3.compose(self._T_room_cam, se3.inverse(told))
        if self._T_room_parent is not None:
            told = se3.compose(self._T_room_parent, told)
            frame = frame.seen_from(told)
        self._rest()
        self._before, self._told_ns, self._T_room_cam = frame, frame.stamp_ns, told
        return frame

    def _go_on(self, frame: RgbdFrame, objects: Callable[[], Sequence[Box]]) -> None:
        """Find out where the camera is, if it moves fast or did a moment ago."""
        before, now_ns = self._before, frame.stamp_ns
        if before is None or before.camera != frame.camera:
            self._rest()
            return
        shift = _shift(before, frame)
        if np.hypot(*shift) > FAST:
            self._fast_ns = now_ns
        if self._fast_ns is None or not 0 <= now_ns - self._fast_ns <= CALM_S * 1e9:
            self._rest()
        else:
            self._measure(before, frame, shift, objects())

    def _rest(self) -> None:
        """Measure nothing until the camera moves fast."""
        self._fast_ns = self._followed = None

    def _measure(self, before: RgbdFrame, frame: RgbdFrame, shift: Float64, objects: Sequence[Box]) -> None:
        """Find out where the camera of a frame was; shift (2,): of its picture; objects: as above."""
        factor = min(1.0, WIDTH_PX / frame.camera.width)
        camera = frame.camera.scaled(factor)
        grey = _grey(frame, camera)
        boxes = [_scaled(box, factor) for box in objects]
        key, seen = self._followed or _begun(before, camera, _grey(before, camera), boxes, self._T_room_cam)
        if _stands(key, grey):
            self._T_room_cam, self._followed = key.T_room_cam, (key, Seen.as_in(key, grey))
            return
        guess = (seen.pixels + shift * camera.width).astype(np.float32)
        found = _moved(key, seen, camera, grey, guess, boxes)
        if found is None:
            self._rest()
            return
        T_cam_key, seen = found
        self._T_room_cam = se3.compose(key.T_room_cam, se3.inverse(T_cam_key))
        worn = len(seen.alive) < WORN * len(key.pixels)
        self._followed = _begun(frame, camera, grey, boxes, self._T_room_cam) if worn else (key, seen)


def _begun(
    frame: RgbdFrame, camera: Camera, grey: UInt8, boxes: Sequence[Box], T_room_cam: Float64
) -> tuple[Keyframe, Seen]:
    """A keyframe made of a frame, and its corners there; camera, boxes: in the smaller picture."""
    corners: Any = cv2.goodFeaturesToTrack(grey, CORNERS, WORST, APART_PX)
    pixels: Float32 = np.zeros((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
    whole = frame.camera.width, frame.camera.height
    inside = (pixels + 0.5) * (np.array(whole) / (camera.width, camera.height)) - 0.5
    columns, rows = np.clip(np.rint(inside).astype(np.int64), 0, np.array(whole) - 1).T
    depth = frame.depth[rows, columns]
    known = depth > NEAR_M
    pixels = np.ascontiguousarray(pixels[known])
    points, probes = camera.backproject(pixels, depth[known]), _probes(pixels, _parts(pixels, boxes))
    key = Keyframe(grey, points, pixels, probes, T_room_cam)
    return key, Seen.as_in(key, grey)


def _moved(
    key: Keyframe, seen: Seen, camera: Camera, grey: UInt8, guess: Float32, boxes: Sequence[Box]
) -> tuple[Float64, Seen] | None:
    """From the keyframe's axes to those of the camera now (4, 4), and the corners there; None where too few
    agree. guess (N, 2): about where the corners are now; boxes: of tracked objects in the last picture."""
    parts = _parts(seen.pixels, boxes)
    pixels, found, off = _flowed(seen.grey, grey, seen.pixels, guess, LEVELS)
    back, found_back, _ = _flowed(grey, seen.grey, pixels, seen.pixels, 1)
    found &= found_back & (np.linalg.norm(back - seen.pixels, axis=1) < OFF_PX)
    found &= ~_noise(seen.grey, grey, seen.pixels, pixels, off)
    alive, pixels = seen.alive[found], pixels[found]
    if len(alive) < FEWEST:
        return None
    points, places = key.points[alive], pixels.astype(np.float64)
    fits, turn, shift, inliers = cv2.solvePnPRansac(
        points, places, camera.K, None, reprojectionError=OFF_PX, flags=cv2.SOLVEPNP_EPNP
    )
    agree = np.zeros(len(alive), bool)
    if fits and inliers is not None:
        agree[np.asarray(inliers).ravel()] = True
    stand = np.linalg.norm(pixels - key.pixels[alive], axis=1) <= STANDS_PX
    if agree.sum() < FEWEST or agree.mean() < MAJORITY or not _by_all(parts[found], agree, stand):
        return None
    turn, shift = cv2.solvePnPRefineLM(points[agree], places[agree], camera.K, None, turn, shift)
    R: Any = cv2.Rodrigues(turn)[0]
    # What moves by itself is not followed on.
    return se3.make(R, np.asarray(shift, np.float64).ravel()), Seen(grey, alive[agree], pixels[agree])


def _shift(before: RgbdFrame, frame: RgbdFrame) -> Float64:
    """By how much the whole picture moved from one frame to the next of the same camera (2,), right and down,
    as shares of its width; zero where the two have nothing in common."""
    size = THUMBNAIL_PX, max(2, round(THUMBNAIL_PX * frame.camera.height / frame.camera.width))
    first, second = (
        cv2.cvtColor(cv2.resize(f.color, size, interpolation=cv2.INTER_NEAREST), cv2.COLOR_RGB2GRAY)
        for f in (before, frame)
    )
    shift, alike = cv2.phaseCorrelate(
        np.asarray(first, np.float32), np.asarray(second, np.float32), _fading(*size)
    )
    return np.array(shift) / THUMBNAIL_PX if alike > 0.0 else np.zeros(2)


@cache
def _fading(width: int, height: int) -> Float32:
    """Weights (h, w) that fall to the border, where a picture does not go on as it does on the other side."""
    return np.asarray(cv2.createHanningWindow((width, height), cv2.CV_32F), np.float32)


def _grey(frame: RgbdFrame, camera: Camera) -> UInt8:
    """The picture in grey, as small as that of a camera."""
    grey = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    size = camera.width, camera.height
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def _scaled(box: Box, factor: float) -> Box:
    """An object's box in a picture made smaller by a factor, with what may be the object's beside it."""
    return Box(*(factor * x for x in (box.x, box.y, box.w, box.h))).grown(0.0, BESIDE_PX)


def _parts(pixels: Float32, boxes: Sequence[Box]) -> Int64:
    """Which part of the picture each corner (N, 2) shows (N,): the number of its box, 0 for the room."""
    parts = np.zeros(len(pixels), np.int64)
    for number, box in enumerate(boxes, 1):
        parts[((pixels >= (box.x, box.y)) & (pixels <= (box.x1, box.y1))).all(1)] = number
    return parts


def _flowed(
    before: UInt8, now: UInt8, pixels: Float32, guess: Float32, levels: int
) -> tuple[Float32, Bool, Float32]:
    """Where points (N, 2) of one picture are in another (N, 2), which were found again (N,), and by how much
    their windows differ then (N,), in grey levels. guess (N, 2): about where; with more levels of the
    pyramids, farther off that."""
    if not len(pixels):
        return pixels, np.zeros(0, bool), np.zeros(0, np.float32)
    there: Any = guess[:, None].copy()
    there, found, off = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        pixels[:, None],
        there,
        winSize=(WINDOW_PX,) * 2,
        maxLevel=levels,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    differ = np.asarray(off, np.float32).ravel()
    return np.asarray(there, np.float32)[:, 0], np.asarray(found).ravel() > 0, differ


def _noise(before: UInt8, now: UInt8, pixels: Float32, there: Float32, off: Float32) -> Bool:
    """Which points (N, 2) of one picture seem to have moved in another, to `there` (N, 2), but their windows
    differ there (N,) nearly as much as if they had stayed."""
    apart = cv2.blur(cv2.absdiff(before, now).astype(np.float32), (WINDOW_PX,) * 2)
    columns, rows = np.clip(np.rint(pixels).astype(np.int64), 0, (now.shape[1] - 1, now.shape[0] - 1)).T
    moved = np.linalg.norm(there - pixels, axis=1) > MOVED_PX
    return np.asarray(moved & (off > EXPLAINED * apart[rows, columns]))


def _probes(pixels: Float32, parts: Int64) -> Int64:
    """Indices (P,) of corners (N, 2): those of the room first, and of them the strongest of each cell."""
    cells = (pixels // CELL_PX).astype(np.int64) @ (1, WIDTH_PX)
    by_cell = np.argsort(cells, kind="stable")
    _, first, count = np.unique(cells[by_cell], return_index=True, return_counts=True)
    rank = np.empty(len(pixels), np.int64)
    rank[by_cell] = np.arange(len(pixels)) - np.repeat(first, count)
    return np.lexsort((rank, parts > 0))[:PROBES]


def _stands(key: Keyframe, grey: UInt8) -> bool:
    """Whether a picture is taken from where the keyframe was."""
    there = key.pixels[key.probes]
    pixels, found, _ = _flowed(key.grey, grey, there, there, 1)
    stand = found & (np.linalg.norm(pixels - there, axis=1) <= STANDS_PX)
    return bool(stand.sum() >= max(1.0, STILL_SHARE * len(there)))


def _by_all(parts: Int64, agree: Bool, stand: Bool) -> bool:
    """Whether the parts (N,) of a picture agree with a motion, by the corners (N,) that agree with it and
    those that stand still."""
    corners, agreeing, standing = (np.bincount(parts, one, minlength=1) for one in (None, agree, stand))
    against = (standing >= VOTE) & (standing >= STILL_SHARE * corners)
    votes = (agreeing >= VOTE) & (agreeing >= MAJORITY * corners) & ~against
    objects = votes[1:].sum()
    return bool((votes[0] if corners[0] >= FEWEST_OF_ROOM else objects >= 2) and objects >= against[1:].sum())
