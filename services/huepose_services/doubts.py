"""Explain in one sentence why a robot must not act on a pose, as far as the frame shows it.

The sentence about a pose (`why_doubted`) decides nothing: the tracker has decided the state, from the same
frame. The pose may be wrong, so the sentence claims nothing that is true only for a right pose: an object
that seems occluded may be fully visible in another orientation. A fault of the frame itself
(`complaint_about`) does decide: then no pose in it may be acted on, however well it fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from huepose.geometry import RgbdFrame
from huepose.geometry.arrays import Float64
from huepose.geometry.camera import depth_noise_m
from huepose.geometry.image_faults import NO_COLOUR, all_grey, dark, readings, same, why_nothing_is_found
from huepose.judge.open_region import PreparedSurface
from huepose.tracking.history import CLOSE_S, WIDE_S
from huepose.tracking.types import Applied, Doubt, TrackedPose
from huepose_protos.messages import CorrectionMessage

NOT_FOUND = "It is not visible where it was, and was not found elsewhere yet."
OUTSIDE = "Most of it is outside the image."
TOO_FAR = "It is too small in the image: too far away."
NO_DEPTH = (
    "There is no depth where most of it should be: it is too near, shiny, transparent or dark, or its pose "
    "is wrong."
)
COVERED = "If its pose is right, something in front of it occludes most of it."
CLOSE_IN_FRONT = "Its pose is wrong, or something close to it occludes most of it."
NOT_THERE = "The camera sees what is behind it: it is not at this pose."
TOO_OLD = (
    "Its present position is not known: this computer is too busy, or the camera's images come late or with "
    "old timestamps."
)
DARK = "The image is too dark there."
TURN = "It fits, but rotated it would fit nearly as well: seen from another side, it becomes sure."
UNCONFIRMED = "It fits, but on little evidence: found here again or seen from another side, it becomes sure."
ANOTHER = "It may be a look-alike: found again or seen from another side, it becomes sure."
LOOSE = "It fits, but too little of it is visible to fix its pose."
FOUND = "It was found just now: if it fits the next frames, it becomes sure."
RELIT = (
    "The colour of the light has changed since it was last sure: found again in this light, it becomes sure."
)
DISAGREES = "Too little of what is visible there agrees with its shape and texture."
_TEXTS = {
    None: DISAGREES,
    Doubt.TURN: TURN,
    Doubt.IDENTITY: UNCONFIRMED,
    Doubt.ANOTHER: ANOTHER,
    Doubt.LOOSE: LOOSE,
    Doubt.FOUND: FOUND,
}

_SAMPLES = 300
_SMALL_PX = 24.0
"""A diameter of this many pixels has about 450 depth readings, of which one in six is independent
(`POINTS_PER_READING`): few to fix a pose, or to decide between two similar ones."""


FOCUS = 0.05
"""Largest share by which focusing changes a focal length: f becomes f / (1 - f / distance), 4 % for 6 mm at
15 cm."""


def why_doubted(
    surface: PreparedSurface,
    frame: RgbdFrame,
    T_cam_obj: Float64 | None,
    doubt: Doubt | None = None,
    relit: bool = False,
) -> str:
    """Why an object at a pose (4, 4) is hardly visible in the frame, or not sure. T_cam_obj is None if it
    is lost. relit: it has not been TRACKING since the colour of the light changed."""
    if T_cam_obj is None:
        return RELIT if relit else NOT_FOUND
    rotation, translation = T_cam_obj[:3, :3], T_cam_obj[:3, 3]
    # The samples that are visible in this pose: not those that the object itself occludes, as inside a mug.
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
    # A larger difference is explained neither by noise nor by the error of a tracked pose.
    slack_m = 3.0 * depth_noise_m(distance_m) + 0.1 * surface.diameter_m
    before_m = points[there, 2] - read_m[there]
    if not _few(before_m > slack_m):
        # Points nearer to the centre may belong to the object itself, rotated or displaced by half its
        # size.
        met = points[there] * (read_m / points[:, 2])[there, None]
        apart = np.linalg.norm(met - surface.centre_cam(T_cam_obj), axis=1) > surface.diameter_m
        return COVERED if not _few(apart & (before_m > slack_m)) else CLOSE_IN_FRONT
    if not _few(before_m < -slack_m):
        return NOT_THERE
    if not _few(dark(frame.color[rows, columns])):
        return DARK
    if doubt in (None, Doubt.TURN) and all_grey(frame.color):
        return NO_COLOUR
    return RELIT if relit and doubt is None else _TEXTS[doubt]


def _few(which: np.ndarray) -> bool:
    """Whether fewer than half are True."""
    return bool(2 * np.count_nonzero(which) < len(which))


def why_all_are_lost(
    frame: RgbdFrame | None, poses: Sequence[TrackedPose], surfaces: Sequence[PreparedSurface]
) -> str:
    """What is wrong with a frame in which every tracked object is LOST; empty if nothing is. surfaces: of
    the objects of the poses."""
    if frame is None or any(pose.T_cam_obj is not None for pose in poses):
        return ""
    return why_nothing_is_found(frame, [surface.diameter_m for surface in surfaces]) or ""


def complaint_about(frame: RgbdFrame, before: RgbdFrame | None) -> str | None:
    """The reason to doubt a frame, from the frame itself and the one before it; None if there is none."""
    if not readings(frame.depth).any():  # the tracked object may be the only thing that has depth
        return (
            "there is no depth in the whole image: is the depth camera covered, its stream off, or its "
            "depth scale wrong?"
        )
    if before is None or before.epoch != frame.epoch:
        return None
    if before.camera != frame.camera:
        return (
            "the image's size or intrinsics changed while the camera was open: a camera with new settings "
            "must begin a new epoch"
        )
    if same(before.color, frame.color) and not same(before.depth, frame.depth):
        return "the colour image stays the same while depth changes: is the colour stream stuck?"
    return None


def lens_doubted(frame: RgbdFrame, fx_of_size: dict[str, float]) -> str | None:
    """The reason to doubt the focal length of a frame: earlier images of the same size had another one.
    None if there is none. fx_of_size: the first fx of each size ("640 x 480"), px; a new size is added.

    With a wrong focal length a pose can fit and still be wrong, and the frame itself does not show which of
    two focal lengths is right."""
    camera = frame.camera
    size = f"{camera.width} x {camera.height}"
    first = fx_of_size.setdefault(size, camera.fx)
    if abs(camera.fx - first) <= FOCUS * first:
        return None
    return (
        f"the focal length of {size} images was {first:.0f} px and is {camera.fx:.0f} px now: one of the "
        "two is wrong. If it is another camera, restart the tracker"
    )


class Against(msgspec.Struct, array_like=True):
    """Perception's reasons to doubt a camera, and single instances in its images, in the newest camera
    epoch: sentences, empty if there is no reason."""

    epoch: int = 0
    camera: str = ""
    instances: dict[str, str] = {}

    def hear(self, message: CorrectionMessage) -> None:
        """Take over what a correction says; it holds until the next correction."""
        if message.camera_epoch != self.epoch:
            self.epoch, self.instances = message.camera_epoch, {}
        self.camera = message.camera
        self.instances[f"{message.object}/{message.instance}"] = message.reason

    def every_pose(self, epoch: int) -> str:
        """The reason to doubt every pose in an image of that epoch."""
        return self.camera if epoch == self.epoch else ""

    def pose(self, pose: TrackedPose, epoch: int) -> str:
        """The reason to doubt this pose in particular; empty if it is LOST."""
        if epoch != self.epoch or pose.T_cam_obj is None:
            return ""
        return self.instances.get(f"{pose.object}/{pose.instance}", "")


_NO_ACTION = "Nothing needs to be done: perception goes on searching"
_FOUND = {"agree": "that {} is where it is tracked", "correct": "another pose of {}", "acquire": "{}"}


def why_refused(
    applied: Applied, followed: bool, age_s: float, reach_s: float | None, older_frames: int
) -> tuple[str, bool]:
    """Why a correction was not applied, and whether that is a fault. followed: whether its instance is
    tracked, or the correction itself gives a pose; reach_s: time span of the kept frames, None until their
    history is full."""
    if applied is Applied.REFUSED_EPOCH:
        return "the camera was opened again since", True
    if not followed or (reach_s is not None and age_s <= reach_s):  # or the tracker has died since
        return f"it is no longer tracked. {_NO_ACTION}", False
    if reach_s is None:
        # The correction was on its way when the tracker started.
        return f"that was before the tracker started. {_NO_ACTION}", False
    return too_late_text(age_s, reach_s, older_frames), True


def refused_text(name: str, verdict: str, age_s: float, why: str) -> str:
    """The log line for a correction that is not applied. verdict: of the correction; age_s: time from its
    image to the newest one."""
    found = _FOUND.get(verdict, "{}").format(name)
    # The clock of a camera that was opened again may have been set back.
    image = f"an image {age_s:.1f} s old" if age_s >= 0.0 else "an older image"
    return f"perception found {found} in {image}; it is not applied: {why}"


def too_late_text(age_s: float, reach_s: float, older_frames: int) -> str:
    """The warning that perception answers later than the tracker keeps frames, and what to do."""
    missing_s = 1.3 * age_s - reach_s
    more = older_frames + 2 * math.ceil(missing_s / (CLOSE_S + WIDE_S))
    return (
        f"perception answers {age_s:.1f} s after an image was taken, and images are kept for "
        f"{reach_s:.1f} s: what it finds cannot be used. Set tracker.older_frames to {more} (2 MB each at "
        "640x480), or make it faster: end other programs, search for fewer objects, or for one at a time "
        "(reinit.objects_per_tick: 1)"
    )
