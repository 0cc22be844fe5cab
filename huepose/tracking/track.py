"""One tracked instance: what is known of it, and what a frame or a correction changes about that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.propose.relative_pose import RelativePose
from huepose.tracking import evidence
from huepose.tracking.catching_up import Pursuit
from huepose.tracking.config import TrackerConfig
from huepose.tracking.evidence import Standing, next_standing, usual_after
from huepose.tracking.history import PoseHistory
from huepose.tracking.identity import Identity, turned_over
from huepose.tracking.motion import filtered, increment_velocity, predicted
from huepose.tracking.scoring import NOTHING, UNKNOWN_TINT, Fit
from huepose.tracking.second_thought import SecondThought, leapt
from huepose.tracking.step import Anchor, Step, Subject, advance
from huepose.tracking.types import State, TrackedPose
from huepose.tracking.uncertainty import covariance, spread_m, unseen

COASTING_SEEN = 0.15
"""With less of the surface confirmed, the prediction is better than what was refined on it."""

COASTING_DAMPING = 0.85
"""Factor of the velocity in every frame without support."""

FORGOTTEN_PER_S = 0.25
"""Score by which less is asked, each second, of an object that returns: the light may have changed."""

SPREAD_POINTS = 48
MAX_TRIES = 3
TRY_AGAIN_AFTER = 15
"""Doubtful frames in a row after which flow and search rest, and every how many they are tried again: an
object that is half hidden for seconds must not cost more than one that is not."""


class Track:
    """The state of one instance. Every live frame it is first `look`ed for, then `settle`d."""

    def __init__(self, subject: Subject, object_name: str, instance: int, config: TrackerConfig) -> None:
        self.subject, self.object, self.instance = subject, object_name, instance
        self.history = PoseHistory()
        self.state = State.SEARCHING
        self.T_cam_obj: Float64 | None = None
        self.velocity: Float64 | None = None
        self.covariance: Float64 | None = None
        self.fit: Fit = NOTHING
        self.quality = 0.0
        self.start = ""
        self.applied_seq = 0
        self._config = config
        self._standing = Standing(State.SEARCHING)
        self._identity: Identity | None = None
        self._evidence = 0.0
        self._usual: float | None = None
        self._tint = UNKNOWN_TINT
        self._frame: RgbdFrame | None = None
        self._doubtful_frames = self._scarce_frames = 0
        self._unseen_s = 0.0
        self._supported_ns = 0
        self._rival: Float64 | None = None
        self._rival_identity: Identity | None = None
        self._second: SecondThought | None = None

    def look(
        self, frame: RgbdFrame, relative_pose: RelativePose | None = None, may_search: bool = True
    ) -> bool:
        """Find the object in the next frame, if it has a pose; says whether that took a search."""
        if self.T_cam_obj is None or self._frame is None:
            return False
        tired = self._doubtful_frames >= MAX_TRIES and self._doubtful_frames % TRY_AGAIN_AFTER != 0
        anchor = Anchor(
            self.T_cam_obj,
            self.velocity,
            self._frame,
            self._usual,
            self._tint,
            rival=self._rival,
            unseen_s=self._unseen_s,
            tired=tired,
        )
        self._rival = None
        config = self._config if may_search else replace(self._config, search=False)
        step = advance(self.subject, anchor, frame, config, relative_pose)
        seconds = (frame.stamp_ns - self._frame.stamp_ns) * 1e-9
        step = self._decided(anchor, step, frame, seconds)
        sure = evidence.quality(step.fit, self._usual, self._evidence)
        if step.near is not None and sure < self._config.suspect_quality:
            # What is found somewhere else and not believed must not draw a half hidden object away.
            step = replace(step.near, doubtful=True, searched=True)
            sure = evidence.quality(step.fit, self._usual, self._evidence)
        self._scarce_frames = self._scarce_frames + 1 if evidence.scarce(step.fit) else 0
        sure = evidence.bounded(sure, self._scarce_frames)
        self.fit, self.start, self._frame, self._evidence = step.fit, step.start, frame, sure
        if step.start == "rival":
            self._identity = self._rival_identity
        if self._evidence >= self._config.lost_quality:
            measured = increment_velocity(self.T_cam_obj, step.T_cam_obj, seconds)
            self.velocity = filtered(self.velocity, measured, seconds)
            self.T_cam_obj, self.covariance = step.T_cam_obj, self._covariance(step)
            self._evidence = evidence.vouched(sure, self._spread())
            self._unseen_s = 0.0
        else:
            self._coast(step, seconds)
            self._unseen_s += seconds
        self._doubtful_frames = self._doubtful_frames + 1 if step.doubtful else 0
        return step.searched

    def _decided(self, anchor: Anchor, step: Step, frame: RgbdFrame, seconds: float) -> Step:
        """What is believed of a frame where there are two opinions about the object since a leap."""
        if self._second is not None:
            surface = self.subject.surface
            self._second, own = self._second.followed(surface, frame, seconds, self._tint, step)
            if self._second.borne_out:
                step = replace(own, doubtful=step.doubtful, searched=step.searched)
            if self._second.borne_out or self._second.refuted:
                self._second = None
        elif step.start != "rival" and leapt(
            self.subject.surface, anchor.T_cam_obj, step.T_cam_obj, seconds, self._config
        ):
            self._second = SecondThought.left_behind(anchor, step, seconds)
        return step

    def settle(self, frame: RgbdFrame, contested: bool = False, since_ns: int = 0) -> None:
        """Judge what `look` found; contested: another pose holds the same surface with better right. Poses
        since a stamp are remembered."""
        if self.T_cam_obj is not None:
            if contested:
                self._evidence = 0.0
            elif self._evidence >= self._config.suspect_quality:
                # Less becomes usual only for a pose that is believed already.
                if self.state is State.TRACKING or self._usual is None or self.fit.total > self._usual:
                    self._usual = usual_after(self._usual, self.fit.total)
                self._supported_ns = frame.stamp_ns
                self._tint = evidence.tint_after(self._tint, self.fit.tint)
                if self._identity is not None and self._evidence >= self._config.tracking_quality:
                    self._identity = self._identity.carried(self.fit, self._view())
            self._judge()
        self.history.append(frame.frame_id, frame.stamp_ns, self.T_cam_obj)
        self.history.forget_before(since_ns)

    def place(self, pursuit: Pursuit, step: Step, frame: RgbdFrame) -> None:
        """Start, or start again, with a pose that was verified on `frame`. Only a correction does this."""
        self.T_cam_obj, self.fit, self.start, self._frame = step.T_cam_obj, step.fit, step.start, frame
        self.velocity, self.covariance = pursuit.velocity, self._covariance(step)
        self._identity = Identity.of(pursuit.correction.quality, self._view())
        self._usual, self._tint, self._evidence = pursuit.usual, pursuit.tint, pursuit.evidence
        self._doubtful_frames, self._scarce_frames, self._unseen_s, self._rival = 0, 0, 0.0, None
        self._second = None
        self._supported_ns = frame.stamp_ns
        # A verified pose may be TRACKING at once.
        self._standing = Standing(State.TRACKING)
        self._judge()

    def remembered(self, stamp_ns: int) -> float | None:
        """The score that was usual before the object was lost; the older, the less it asks for."""
        if self._usual is None:
            return None
        return self._usual - FORGOTTEN_PER_S * max(0.0, (stamp_ns - self._supported_ns) * 1e-9)

    def replay(self, stamp_ns: int, T_cam_obj: Float64, quality: float) -> None:
        """Take a correction of a kept pose: the increments since then carry it to now.

        Raises ValueError where the history does not reach back unbroken."""
        moved = self.history.replay(stamp_ns, T_cam_obj)
        self._second = None
        if self.velocity is not None and self.T_cam_obj is not None:
            # The same motion, about an origin that has moved.
            lever = moved[:3, 3] - self.T_cam_obj[:3, 3]
            self.velocity = np.concatenate(
                [self.velocity[:3] + np.cross(self.velocity[3:], lever), self.velocity[3:]]
            )
        # What was there before may come back if the next frame says so.
        self._rival, self.T_cam_obj = self.T_cam_obj, moved
        self._rival_identity = self._identity
        if self._rival is None or self._identity is None or turned_over(self._rival, moved):
            self._identity = Identity.of(quality, self._view())
        else:
            self._identity = self._identity.agreed(quality, self._view())

    def agree(self, quality: float) -> None:
        """Perception found the same pose by itself."""
        self._second = None
        if self._identity is not None and self.T_cam_obj is not None:
            self._usual = self.fit.total
            self._identity = self._identity.agreed(quality, self._view())

    def published(self, frame: RgbdFrame) -> TrackedPose:
        """What is said of it about that frame."""
        return TrackedPose(
            self.object,
            self.instance,
            frame.epoch,
            frame.frame_id,
            frame.stamp_ns,
            self.state,
            self.T_cam_obj,
            self.velocity,
            self.quality,
            self.covariance,
            self.applied_seq,
        )

    def _coast(self, step: Step, seconds: float) -> None:
        """A frame that does not support the pose: keep to the prediction where hardly anything is seen."""
        assert self.T_cam_obj is not None
        hardly = step.fit.seen < COASTING_SEEN
        self.T_cam_obj = predicted(self.T_cam_obj, self.velocity, seconds) if hardly else step.T_cam_obj
        if self.velocity is not None:
            self.velocity = self.velocity * COASTING_DAMPING
        if self.covariance is not None:
            self.covariance = unseen(self.covariance, seconds)

    def _judge(self) -> None:
        identity = 0.0 if self._identity is None else self._identity.value
        self.quality = self._evidence * identity
        confirmed = identity >= self._config.confirmed_identity and self._second is None
        self._standing = next_standing(self._standing, self._evidence, confirmed, self._config)
        self.state = self._standing.state
        if self.state is State.LOST:
            self.T_cam_obj = self.velocity = self.covariance = None
            self.quality = 0.0

    def _view(self) -> Float64:
        """Direction (3,) from the object to the camera, object axes."""
        assert self.T_cam_obj is not None
        eye = -self.T_cam_obj[:3, :3].T @ self.subject.surface.centre_cam(self.T_cam_obj)
        return np.asarray(eye / max(float(np.linalg.norm(eye)), 1e-9))

    def _spread(self) -> float:
        """By how much the pose may be off, as a share of the diameter."""
        assert self.T_cam_obj is not None
        assert self.covariance is not None
        surface = self.subject.surface
        points = surface.arrays.points[:SPREAD_POINTS]
        return spread_m(self.covariance, self.T_cam_obj, points) / surface.diameter_m

    def _covariance(self, step: Step) -> Float64:
        return covariance(step.information, float(self.subject.surface.centre_cam(step.T_cam_obj)[2]))
