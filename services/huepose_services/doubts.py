"""Explain to people, in one sentence, why a pose should not be acted on, as far as the frame shows it.

What is said of a pose (`why_doubted`) is no judgement: the state was decided by the tracker, from the same
frame. The pose may be wrong, so nothing is said that only a right one would make true: what looks covered may
stand in full view, turned another way. What is wrong with a frame as such (`complaint_about`) is a judgement:
no pose in it is to be acted on, however well it fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import depth_noise_m
from huepose.geometry.picture_faults import NO_COLOUR, all_grey, dark, readings, same, why_nothing_is_found
from huepose.judge.open_region import PreparedSurface
from huepose.tracking.history import CLOSE_S, WIDE_S
from huepose.tracking.types import Applied, Doubt, TrackedPose
from huepose_protos.messages import CorrectionMessage

NOT_FOUND = "It is not seen where it was, and was not found elsewhere yet."
OUTSIDE = "Most of it is outside of the picture."
TOO_FAR = "It is too small in the picture: too far away."
NO_DEPTH = (
    "There is no depth where most of it should be: it is too near, shiny, transparent or dark, or its pose "
    "is wrong."
)
COVERED = "If its pose is right, something in front of it hides most of it."
CLOSE_IN_FRONT = "Its pose is wrong, or something that lies close to it hides most of it."
NOT_THERE = "The camera sees what is behind it: it is not where this pose has it."
TOO_OLD = (
    "It is not known where it is now: this computer is too busy, or the camera's pictures come late or with "
    "old stamps."
)
DARK = "The picture is too dark there."
TURN = "It fits, but turned another way it would fit nearly as well: seen from another side it becomes sure."
UNCONFIRMED = "It fits, but was found on little: found here again or seen from another side, it is sure."
ANOTHER = "It may be another thing that looks like it: found again or seen from another side, it is sure."
LOOSE = "It fits, but too little of it is seen to say exactly where it is."
FOUND = "It was found just now: if the next frames agree it is sure."
RELIT = "The colour of the light changed when it was last sure: found again in this light it is sure."
DISAGREES = "Too little of what is seen there agrees with its shape and texture."
_SAID = {
    None: DISAGREES,
    Doubt.TURN: TURN,
    Doubt.IDENTITY: UNCONFIRMED,
    Doubt.ANOTHER: ANOTHER,
    Doubt.LOOSE: LOOSE,
    Doubt.FOUND: FOUND,
}

_SAMPLES = 300
_SMALL_PX = 24.0
"""So many pixels across are some 450 readings, of which one in six is independent (`POINTS_PER_READING`): few
for a pose, and for which of two like ones it is."""


FOCUS = 0.05
"""Share by which focusing changes a focal length: f becomes f / (1 - f / distance), 4 % for 6 mm at 15 cm."""


def why_doubted(
    surface: PreparedSurface,
    frame: RgbdFrame,
    T_cam_obj: Float64 | None,
    doubt: Doubt | None = None,
    relit: bool = False,
) -> str:
    """What keeps an object at that pose (4, 4), None where it is lost, from being seen well in the frame.
    relit: it is so since the light changed."""
    if T_cam_obj is None:
        return RELIT if relit else NOT_FOUND
    rotation, translation = T_cam_obj[:3, :3], T_cam_obj[:3, 3]
    # What this pose would show: none that its own front hides, as the inside of a mug.
    shown = surface.shown(T_cam_obj, _SAMPLES)
    points = surface.arrays.points[shown].astype(np.float64) @ rotation.T + translation
    points = points[points[:, 2] > 0.0]
    if not len(points):
        return OUTSIDE
    pixels = np.rint(frame.camera.project(points)).astype(np.int64)
    size = (frame.camera.width, frame.camera.height)
    inside = np.all((pixels >= 0) & (pixels < size), axis=1)
    if _few(inside):
        return OUTSIDE
    distance_m = float(np.median(points[:, 2]))
    if frame.camera.fx * surface.diameter_m < _SMALL_PX * distance_m:
        return TOO_FAR
    columns, rows = pixels[inside].T
    points, read_m = points[inside], frame.depth[rows, columns].astype(np.float64)
    there = readings(frame.depth[rows, columns])
    if _few(there):
        return NO_DEPTH
    # As far off as neither noise nor a pose that is followed at all explains.
    slack_m = 3.0 * depth_noise_m(distance_m) + 0.1 * surface.diameter_m
    before_m = points[there, 2] - read_m[there]
    if not _few(before_m > slack_m):
        # What is nearer to the centre may be the object itself, turned another way or half its size away.
        met = points[there] * (read_m / points[:, 2])[there, None]
        apart = np.linalg.norm(met - surface.centre_cam(T_cam_obj), axis=1) > surface.diameter_m
        return COVERED if not _few(apart & (before_m > slack_m)) else CLOSE_IN_FRONT
    if not _few(before_m < -slack_m):
        return NOT_THERE
    if not _few(dark(frame.color[rows, columns])):
        return DARK
    if doubt in (None, Doubt.TURN) and all_grey(frame.color):
        return NO_COLOUR
    return RELIT if relit and doubt is None else _SAID[doubt]


def _few(which: np.ndarray) -> bool:
    """Fewer than half."""
    return bool(2 * np.count_nonzero(which) < len(which))


def why_all_are_lost(
    frame: RgbdFrame | None, poses: Sequence[TrackedPose], surfaces: Sequence[PreparedSurface]
) -> str:
    """What is wrong with a frame in which no object has a pose any more; empty where nothing is. surfaces: of
    the objects of the poses."""
    if frame is None or any(pose.T_cam_obj is not None for pose in poses):
        return ""
    return why_nothing_is_found(frame, [surface.diameter_m for surface in surfaces]) or ""


def complaint_about(frame: RgbdFrame, before: RgbdFrame | None) -> str | None:
    """The reason to doubt a frame, by itself and beside the one before it; None where there is none."""
    if not readings(frame.depth).any():  # a tracked object may be all that has depth
        return (
            "there is no depth in the whole picture: is the depth camera covered, its stream off, or its "
            "depth scale wrong?"
        )
    if before is None or before.epoch != frame.epoch:
        return None
    if before.camera != frame.camera:
        return (
            "the picture's size or intrinsics changed while the camera was open: a camera that is set anew "
            "must begin a new epoch"
        )
    if same(before.color, frame.color) and not same(before.depth, frame.depth):
        return "the colour picture stands still while depth goes on: is the colour stream stuck?"
    return None


def lens_doubted(frame: RgbdFrame, fx_of_size: dict[str, float]) -> str | None:
    """The reason to doubt the focal length that a frame states: pictures of its size had another one before.
    fx_of_size: the first of each size ("640 x 480"), px; of a new size it is added.

    A pose that fits through the wrong lens is not where it is, and nothing in the frame itself tells which of
    two lenses is the right one."""
    camera = frame.camera
    size = f"{camera.width} x {camera.height}"
    first = fx_of_size.setdefault(size, camera.fx)
    if abs(camera.fx - first) <= FOCUS * first:
        return None
    return (
        f"the focal length of {size} pictures was {first:.0f} px and is {camera.fx:.0f} px now: one of the "
        "two is wrong. If it is another camera, restart the tracker"
    )


class Against(msgspec.Struct, array_like=True):
    """What perception says against a camera, and against single instances in its pictures: sentences, empty
    where there is nothing to say; of one epoch of the camera, the newest."""

    epoch: int = 0
    camera: str = ""
    instances: dict[str, str] = {}

    def hear(self, message: CorrectionMessage) -> None:
        """What a correction says is so until another one says otherwise."""
        if message.camera_epoch != self.epoch:
            self.epoch, self.instances = message.camera_epoch, {}
        self.camera = message.camera
        self.instances[f"{message.object}/{message.instance}"] = message.reason

    def every_pose(self, epoch: int) -> str:
        """What is said against every pose in a picture of that epoch."""
        return self.camera if epoch == self.epoch else ""

    def pose(self, pose: TrackedPose, epoch: int) -> str:
        """What is said against one in particular; nothing of one that is lost."""
        if epoch != self.epoch or pose.T_cam_obj is None:
            return ""
        return self.instances.get(f"{pose.object}/{pose.instance}", "")


_NO_ACTION = "Nothing needs to be done: perception looks on"
_FOUND = {"agree": "that {} is where it is followed", "correct": "another pose of {}", "acquire": "{}"}


def why_refused(
    applied: Applied, followed: bool, age_s: float, reach_s: float | None, older_frames: int
) -> tuple[str, bool]:
    """Why a correction was not applied, and whether something is wrong. followed: whether its instance is, or
    it gives a pose itself; reach_s: of the kept frames, None while they are few."""
    if applied is Applied.REFUSED_EPOCH:
        return "the camera was opened anew since", True
    if not followed or (reach_s is not None and age_s <= reach_s):  # or the tracker has died since
        return f"it is not followed any more. {_NO_ACTION}", False
    if reach_s is None:
        # It was on its way when the tracker started.
        return f"that was before the tracker began. {_NO_ACTION}", False
    return too_late_text(age_s, reach_s, older_frames), True


def refused_text(name: str, verdict: str, age_s: float, why: str) -> str:
    """The line of the log for a correction that is not applied. verdict: of the correction; age_s: of the
    picture that it is about, before the newest one."""
    found = _FOUND.get(verdict, "{}").format(name)
    # The clock of a camera that was opened anew may have been set back.
    picture = f"a picture {age_s:.1f} s old" if age_s >= 0.0 else "an older picture"
    return f"perception found {found} in {picture}; it is not taken over: {why}"


def too_late_text(age_s: float, reach_s: float, older_frames: int) -> str:
    """The warning that perception answers later than the tracker's frame history reaches, and what to do."""
    missing_s = 1.3 * age_s - reach_s
    more = older_frames + 2 * math.ceil(missing_s / (CLOSE_S + WIDE_S))
    return (
        f"perception answers {age_s:.1f} s after a picture was taken, and pictures are kept for "
        f"{reach_s:.1f} s: what it finds cannot be used. Set tracker.older_frames to {more} (2 MB each at "
        "640x480), or make it faster: end other programs, look for fewer objects, or for one at a time "
        "(reinit.objects_per_tick: 1)"
    )
