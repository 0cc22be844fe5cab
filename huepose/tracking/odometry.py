"""Visual odometry: the camera motion, measured from its images where no camera pose is given.

- Corners of a keyframe, with their depth, are tracked from image to image (Lucas and Kanade, pyramidal,
  forward and back). The camera pose is the one with most inliers (EPnP in RANSAC, then least squares).
- If too few corners are found again after a long step, SIFT features of the last two images are matched.
- A camera is static while half of the corners are where they were in the keyframe. So a static camera does
  not drift. If the motion cannot be measured, the camera is taken for static.
- A slowly moving camera is not measured: a tracker follows small motions of the whole image just as well.
  The shift of the whole image (`camera_shift`) is the first guess of where corners are.

Constants without another origin were chosen on films of `studies.on_hand` (seeds 924 and 904) and on the
built-in scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float32, Float64, Int64, UInt8
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAR_M, Camera
from huepose.geometry.frame import RgbdFrame
from huepose.propose.features import Sift, distinct
from huepose.propose.products import product
from huepose.tracking.camera_shift import FAST, image_shift, quarters_shift, thumbnail

CALM_S, QUARTERS_S = 1.0, 0.1
"""So long after the camera moved fast its motion is measured; quarters of the image, which cost 0.2 ms, are
compared once in QUARTERS_S at most."""

WIDTH_PX = 320
"""Corners are tracked in images of this width, or of the camera's own width if that is less."""

CORNERS, APART_PX, WORST = 300, 7, 0.01
"""Most corners of a keyframe, their least distance, and the least strength of one as a share of the
strongest."""

WINDOW_PX, LEVELS = 15, 4
"""Lucas and Kanade: side of a window, and levels of the pyramids. Corners are found again up to about a
hundred pixels from the first guess."""

PROBES, CELL_PX, STATIC_PX, STATIC_SHARE = 40, 40, 0.12, 0.5
"""A camera is static if this share of PROBES corners, spread over cells of the image, is within STATIC_PX
of where it was in the keyframe. An object that moves before a static camera seldom covers more than half of
them."""

MOVED_PX, EXPLAINED = 0.3, 0.6
"""If a corner moves by more than MOVED_PX, its window must differ there by less than this share of its
difference at the old place; else noise was tracked. The share is 0.04 to 0.2 before a camera on a hand (six
films), and 0.85 to 0.89 before a smooth wall."""

OFF_PX = 0.75
"""Largest reprojection error of an inlier, and of a corner that is tracked back to where it came from."""

LONG_STEP_S, MATCHED_PX = 0.06, 1.5
"""SIFT features are matched after steps of more than a frame at 30 Hz, which leave time for it (25 CPU ms);
and the largest reprojection error of an inlier. A feature is located less precisely than a corner is tracked:
with OFF_PX half of the right matches are outliers."""

FEWEST, MAJORITY = 25, 0.5
"""Least number of inliers of a motion, and their least share of all corners that were found again."""

VOTE, FEWEST_OF_BACKGROUND = 3, 10
"""Parts of the image are the tracked objects and the background, which is all the rest. A part is static if
at least VOTE of its corners, and STATIC_SHARE of them, have not moved. It agrees with a motion if at least
VOTE, and MAJORITY, are inliers. The background has to agree; if it has fewer than FEWEST_OF_BACKGROUND
corners, two objects have to. And at least as many objects must agree as are static: else something large
passes before a static camera."""

BESIDE_PX = 5.0
"""A corner up to so far outside of an object's box may be on its outline."""

SILENT_S = 1.0
"""So long after the last given camera pose, odometry takes over. A robot gives ten per second, and some are
missing."""

WORN = 0.9
"""A new keyframe begins when less than this share of a keyframe's corners is left: corners that are tracked
from image to image drift."""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """grey (h, w): the image; points (N, 3): corners in camera axes, metres; pixels (N, 2), strongest
    first; probes (P,): indices of the corners that decide whether the camera is static; T_room_cam (4, 4)."""

    grey: UInt8
    points: Float64
    pixels: Float32
    probes: Int64
    T_room_cam: Float64


@dataclass(frozen=True, eq=False)
class Seen:
    """The last image, grey (h, w); alive (N,): indices of the keyframe's corners that are tracked in it;
    pixels (N, 2): where they are."""

    grey: UInt8
    alive: Int64
    pixels: Float32

    @staticmethod
    def as_in(key: Keyframe, grey: UInt8) -> Seen:
        """An image in which all corners are where they are in the keyframe."""
        return Seen(grey, np.arange(len(key.pixels)), key.pixels)


class Odometry:
    """Adds camera poses to the frames of one camera. The given pose of a frame is used; if none is given,
    and `on`, it is measured. All are in the axes of what came first: poses that are given after measured
    ones are transformed.

    A single frame without a given pose stays without: the next given pose says better how the camera moved.
    It is measured all the same, so that odometry can go on if no more poses are given (`SILENT_S`)."""

    def __init__(self, on: bool = True) -> None:
        self._on = on
        self._T_room_parent: Float64 | None = None
        self._given_ns: int | None = None
        self._before: RgbdFrame | None = None
        self._fast_ns: int | None = None
        self._quarters_ns: int | None = None
        self._tracked: tuple[Keyframe, Seen] | None = None
        self._T_room_cam: Float64 = np.eye(4)

    def placed(self, frame: RgbdFrame, objects: Callable[[], Sequence[Box]]) -> RgbdFrame:
        """The next frame, with its camera pose. objects: returns the boxes of tracked objects in the last
        frame."""
        if not self._on:
            return frame
        given, given_ns = frame.T_parent_cam, self._given_ns
        silent = given_ns is None or not 0 <= frame.stamp_ns - given_ns <= SILENT_S * 1e9
        if given is None or silent:
            self._update(frame, objects)
        if given is None:
            self._before = frame.seen_from(self._T_room_cam)
            return self._before if silent else frame
        if silent and self._before is not None:
            self._T_room_parent = se3.compose(self._T_room_cam, se3.inverse(given))
        if self._T_room_parent is not None:
            given = se3.compose(self._T_room_parent, given)
            frame = frame.seen_from(given)
        self._rest()
        self._before, self._given_ns, self._T_room_cam = frame, frame.stamp_ns, given
        return frame

    def _update(self, frame: RgbdFrame, objects: Callable[[], Sequence[Box]]) -> None:
        """Measure the camera pose if the camera moves fast, or did so within the last CALM_S."""
        before, now_ns = self._before, frame.stamp_ns
        if before is None or before.camera != frame.camera:
            self._rest()
            return
        thumbnails = thumbnail(before), thumbnail(frame)
        shift = image_shift(*thumbnails)
        if np.hypot(*shift) > FAST or (self._quarters_due(now_ns) and quarters_shift(*thumbnails)):
            self._fast_ns = now_ns
        if self._fast_ns is None or not 0 <= now_ns - self._fast_ns <= CALM_S * 1e9:
            self._rest()
        else:
            self._measure(before, frame, shift, objects())

    def _quarters_due(self, now_ns: int) -> bool:
        """Whether quarters of the image are to be compared now: once in QUARTERS_S at most."""
        if self._quarters_ns is not None and 0 <= now_ns - self._quarters_ns < QUARTERS_S * 1e9:
            return False
        self._quarters_ns = now_ns
        return True

    def _rest(self) -> None:
        """Stop measuring until the camera moves fast."""
        self._fast_ns = self._tracked = None

    def _measure(self, before: RgbdFrame, frame: RgbdFrame, shift: Float64, objects: Sequence[Box]) -> None:
        """Measure the camera pose of a frame. shift (2,): of the whole image since the last frame; objects:
        boxes of tracked objects in the last frame."""
        factor = min(1.0, WIDTH_PX / frame.camera.width)
        camera = frame.camera.scaled(factor)
        grey = _grey(frame, camera)
        boxes = [_scaled(box, factor) for box in objects]
        key, seen = self._tracked or _begun(before, camera, _grey(before, camera), boxes, self._T_room_cam)
        if _is_static(key, grey):
            self._T_room_cam, self._tracked = key.T_room_cam, (key, Seen.as_in(key, grey))
            return
        guess = (seen.pixels + shift * camera.width).astype(np.float32)
        found = _moved(key, seen, camera, grey, guess, boxes)
        if found is None:
            self._measure_long_step(before, frame, camera, (seen.grey, grey), boxes)
            return
        T_cam_key, seen = found
        self._T_room_cam = se3.compose(key.T_room_cam, se3.inverse(T_cam_key))
        worn = len(seen.alive) < WORN * len(key.pixels)
        self._tracked = _begun(frame, camera, grey, boxes, self._T_room_cam) if worn else (key, seen)

    def _measure_long_step(
        self,
        before: RgbdFrame,
        frame: RgbdFrame,
        camera: Camera,
        greys: tuple[UInt8, UInt8],
        boxes: Sequence[Box],
    ) -> None:
        """Measure the camera pose of a frame by matched features, if the step is long; else give up. camera,
        greys (h, w), boxes: of the smaller images of the last frame and this one."""
        long = frame.stamp_ns - before.stamp_ns > LONG_STEP_S * 1e9
        T_cam_before = _matched(before, camera, *greys, boxes) if long else None
        if T_cam_before is None:
            self._rest()
            return
        self._T_room_cam = se3.compose(self._T_room_cam, se3.inverse(T_cam_before))
        self._tracked = _begun(frame, camera, greys[1], boxes, self._T_room_cam)


def _begun(
    frame: RgbdFrame, camera: Camera, grey: UInt8, boxes: Sequence[Box], T_room_cam: Float64
) -> tuple[Keyframe, Seen]:
    """A new keyframe, and its corners in it. camera, boxes: of the smaller image."""
    corners: Any = cv2.goodFeaturesToTrack(grey, CORNERS, WORST, APART_PX)
    pixels: Float32 = np.zeros((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
    depth = _depth_at(frame, camera, pixels)
    known = depth > NEAR_M
    pixels = np.ascontiguousarray(pixels[known])
    points, probes = camera.backproject(pixels, depth[known]), _probes(pixels, _parts(pixels, boxes))
    key = Keyframe(grey, points, pixels, probes, T_room_cam)
    return key, Seen.as_in(key, grey)


def _moved(
    key: Keyframe, seen: Seen, camera: Camera, grey: UInt8, guess: Float32, boxes: Sequence[Box]
) -> tuple[Float64, Seen] | None:
    """T_cam_key (4, 4) of a new image by its tracked corners, and these; None if too few agree. guess (N,
    2): about where the corners are now; boxes: of tracked objects in the last image."""
    parts = _parts(seen.pixels, boxes)
    pixels, found, off = _track(seen.grey, grey, seen.pixels, guess, LEVELS)
    back, found_back, _ = _track(grey, seen.grey, pixels, seen.pixels, 1)
    found &= found_back & (np.linalg.norm(back - seen.pixels, axis=1) < OFF_PX)
    found &= ~_noise(seen.grey, grey, seen.pixels, pixels, off)
    alive, pixels = seen.alive[found], pixels[found]
    if len(alive) < FEWEST:
        return None
    static = np.linalg.norm(pixels - key.pixels[alive], axis=1) <= STATIC_PX
    fitted = _fitted(key.points[alive], pixels, camera, parts[found], static, OFF_PX)
    if fitted is None:
        return None
    # Outliers move by themselves, so they are not tracked any more.
    return fitted[0], Seen(grey, alive[fitted[1]], pixels[fitted[1]])


def _matched(
    before: RgbdFrame, camera: Camera, grey_before: UInt8, grey: UInt8, boxes: Sequence[Box]
) -> Float64 | None:
    """T_cam_before (4, 4) of a new image by SIFT features matched with those of the last frame, however far
    they moved; None if too few agree. boxes: of tracked objects in the last frame."""
    sift = Sift()
    first, second = (
        sift.extract(np.asarray(cv2.cvtColor(one, cv2.COLOR_GRAY2RGB), np.uint8))
        for one in (grey_before, grey)
    )
    if min(len(first), len(second)) < FEWEST:
        return None
    similarity = product(first.descriptors, second.descriptors.T)
    rows, best = np.arange(len(first)), similarity.argmax(1)
    mutual = similarity.argmax(0)[best] == rows
    most = similarity[rows, best]
    similarity[rows, best] = 0.0
    depth = _depth_at(before, camera, first.pixels)
    used = mutual & distinct(most, similarity.max(1)) & (depth > NEAR_M)
    if np.count_nonzero(used) < FEWEST:
        return None
    pixels, there = first.pixels[used], second.pixels[best[used]]
    static = np.linalg.norm(there - pixels, axis=1) <= OFF_PX
    fitted = _fitted(
        camera.backproject(pixels, depth[used]), there, camera, _parts(pixels, boxes), static, MATCHED_PX
    )
    return None if fitted is None else fitted[0]


def _fitted(
    points: Float64, pixels: Float32, camera: Camera, parts: Int64, static: Bool, off_px: float
) -> tuple[Float64, Bool] | None:
    """The transform (4, 4) from points (N, 3) to the camera in whose image they are at pixels (N, 2), and
    the inliers (N,) up to off_px; None if too few, or too few of their parts (N,), agree. static (N,):
    which have not moved."""
    places = pixels.astype(np.float64)
    fits, turn, shift, inliers = cv2.solvePnPRansac(
        points, places, camera.K, None, reprojectionError=off_px, flags=cv2.SOLVEPNP_EPNP
    )
    agree = np.zeros(len(points), bool)
    if fits and inliers is not None:
        agree[np.asarray(inliers).ravel()] = True
    if agree.sum() < FEWEST or agree.mean() < MAJORITY or not _parts_agree(parts, agree, static):
        return None
    turn, shift = cv2.solvePnPRefineLM(points[agree], places[agree], camera.K, None, turn, shift)
    R: Any = cv2.Rodrigues(turn)[0]
    return se3.make(R, np.asarray(shift, np.float64).ravel()), agree


def _depth_at(frame: RgbdFrame, camera: Camera, pixels: Float32) -> Float32:
    """Depth (N,) of a frame, metres, at pixels (N, 2) of its smaller image; camera: of the smaller image."""
    whole = np.array((frame.camera.width, frame.camera.height))
    inside = (pixels + 0.5) * (whole / (camera.width, camera.height)) - 0.5
    columns, rows = np.clip(np.rint(inside).astype(np.int64), 0, whole - 1).T
    return np.asarray(frame.depth[rows, columns], np.float32)


def _grey(frame: RgbdFrame, camera: Camera) -> UInt8:
    """The grey image in the size of a camera's."""
    grey = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    size = camera.width, camera.height
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def _scaled(box: Box, factor: float) -> Box:
    """An object's box in an image scaled by a factor, grown by BESIDE_PX."""
    return Box(*(factor * x for x in (box.x, box.y, box.w, box.h))).grown(0.0, BESIDE_PX)


def _parts(pixels: Float32, boxes: Sequence[Box]) -> Int64:
    """The part of the image each corner (N, 2) belongs to (N,): the number of its box, 0 for the
    background."""
    parts = np.zeros(len(pixels), np.int64)
    for number, box in enumerate(boxes, 1):
        parts[((pixels >= (box.x, box.y)) & (pixels <= (box.x1, box.y1))).all(1)] = number
    return parts


def _track(
    before: UInt8, now: UInt8, pixels: Float32, guess: Float32, levels: int
) -> tuple[Float32, Bool, Float32]:
    """Track points (N, 2) of one image in another: where they are (N, 2), which were found again (N,), and
    by how much their windows differ (N,), grey levels. guess (N, 2): about where; with more levels of the
    pyramids, the guess may be farther off."""
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
    """Which points (N, 2) seem to have moved to `there` (N, 2), but whose windows differ there (`off`, N)
    nearly as much as at the old place: noise was tracked."""
    apart = cv2.blur(cv2.absdiff(before, now).astype(np.float32), (WINDOW_PX,) * 2)
    columns, rows = np.clip(np.rint(pixels).astype(np.int64), 0, (now.shape[1] - 1, now.shape[0] - 1)).T
    moved = np.linalg.norm(there - pixels, axis=1) > MOVED_PX
    return np.asarray(moved & (off > EXPLAINED * apart[rows, columns]))


def _probes(pixels: Float32, parts: Int64) -> Int64:
    """Indices (P,) of corners (N, 2): those of the background first, the strongest of each cell before
    others."""
    cells = (pixels // CELL_PX).astype(np.int64) @ (1, WIDTH_PX)
    by_cell = np.argsort(cells, kind="stable")
    _, first, count = np.unique(cells[by_cell], return_index=True, return_counts=True)
    rank = np.empty(len(pixels), np.int64)
    rank[by_cell] = np.arange(len(pixels)) - np.repeat(first, count)
    return np.lexsort((rank, parts > 0))[:PROBES]


def _is_static(key: Keyframe, grey: UInt8) -> bool:
    """Whether the camera of an image is where it was in the keyframe."""
    there = key.pixels[key.probes]
    pixels, found, _ = _track(key.grey, grey, there, there, 1)
    static = found & (np.linalg.norm(pixels - there, axis=1) <= STATIC_PX)
    return bool(static.sum() >= max(1.0, STATIC_SHARE * len(there)))


def _parts_agree(parts: Int64, agree: Bool, static: Bool) -> bool:
    """Whether enough parts of an image agree with a motion. parts (N,): of each corner; agree (N,): inliers
    of the motion; static (N,): corners that have not moved."""
    corners, agreeing, unmoved = (np.bincount(parts, one, minlength=1) for one in (None, agree, static))
    against = (unmoved >= VOTE) & (unmoved >= STATIC_SHARE * corners)
    votes = (agreeing >= VOTE) & (agreeing >= MAJORITY * corners) & ~against
    objects = votes[1:].sum()
    return bool(
        (votes[0] if corners[0] >= FEWEST_OF_BACKGROUND else objects >= 2) and objects >= against[1:].sum()
    )
