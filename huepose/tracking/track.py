"""One tracked instance: the pose of an object over time, as up to three hypotheses, updated by frames and by
corrections. What is believed of the pose is in `tracking.belief`."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import taken_by
from huepose.judge.terms import NOTHING, Terms
from huepose.select.distinct import RIGHT
from huepose.tracking import evidence
from huepose.tracking.belief import Belief
from huepose.tracking.camera_place import STATIC, CameraPlace
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import PARTS
from huepose.tracking.history import PoseHistory
from huepose.tracking.hypothesis import LOOKED_FOR, Anchor, Hypothesis, distinct, same_pose
from huepose.tracking.looks import LOOK_S, looks
from huepose.tracking.lost import MORE, MOSTLY, found_at_last_place, found_elsewhere, visible_share
from huepose.tracking.motion import Reach, predicted, same_motion
from huepose.tracking.opinions import opinions, weighed
from huepose.tracking.orientation import SHARPNESS, Better
from huepose.tracking.persistence import Persistence
from huepose.tracking.refined import unmoved
from huepose.tracking.stages import END, NEARBY
from huepose.tracking.step import Advance, advance, found_nearby
from huepose.tracking.subject import Subject
from huepose.tracking.types import Correction
from huepose.tracking.uncertainty import uncertainty

COASTING_SEEN = 0.15
"""If depth confirms less than this share of the surface, the predicted pose is better than the refined
one."""

COASTING_DAMPING = 0.85
"""The velocity is multiplied by this in each look that does not support the pose."""


class Track:
    """The pose of one instance, and the belief in it. In each live frame `look` finds the pose, then
    `update_state` sets the state."""

    def __init__(self, subject: Subject, object_name: str, instance: int, config: TrackerConfig) -> None:
        self.subject, self.object, self.instance = subject, object_name, instance
        self.history = PoseHistory(self.subject.surface.middle_obj)
        self.hypotheses: tuple[Hypothesis, ...] = ()
        self.covariance: Float64 | None = None
        self.belief = Belief(subject, config)
        self.applied_seq = 0
        self.frame: RgbdFrame | None = None
        self._config = config
        self._looked_ns, self._apart_s = 0, LOOK_S
        self._camera = CameraPlace()
        self._searched = Persistence()
        self._begin()

    def _begin(self) -> None:
        """Reset the search, and the time without support."""
        self._persistence, self._unseen_s = Persistence(), 0.0
        self._place: Reach | None = None
        self._stood: float | None = None

    @property
    def T_cam_obj(self) -> Float64 | None:
        """The pose (4, 4) of the first hypothesis; None without one."""
        return self.hypotheses[0].T_cam_obj if self.hypotheses else None

    @property
    def velocity(self) -> Float64 | None:
        """The velocity of that pose relative to the camera: a twist (6,) along camera axes about the object's
        centre; None if it is not known."""
        if not self.hypotheses:
            return None
        return self._camera.relative(self.subject.surface, self.hypotheses[0]).velocity

    @property
    def terms(self) -> Terms:
        """The judge's terms of that pose."""
        return self.hypotheses[0].terms if self.hypotheses else NOTHING

    @property
    def halfway(self) -> bool:
        """Whether it has found a place that the next frame should search."""
        return self._place is not None

    @property
    def worth(self) -> float:
        """The total of its pose plus the log-odds of its orientation, in units of a total."""
        return self.terms.total + self.belief.orientation.worth

    def look(self, frame: RgbdFrame, tries: float = np.inf, twins: Sequence[Float64] = ()) -> float:
        """Find the object in the next frame. Returns how many of at most `tries` costly proposals were used.
        twins: poses (4, 4) of other instances of the object; a lost one is not searched for there."""
        self._apart_s = (frame.stamp_ns - self._looked_ns) * 1e-9
        self._look_from(frame)
        if self.frame is None or not self.hypotheses:
            return self._look_everywhere(frame, tries, twins)
        begun = self._persistence.begun
        resting = begun == NEARBY and self._persistence.resting
        belief, orientation = self.belief, self.belief.orientation
        facing = orientation.facing
        turn_odds = 0.0 if facing is None else facing.value
        last = self.hypotheses, self.frame, belief.usual
        anchor = Anchor(*last, self._unseen_s, self._place, belief.known, turn_odds)
        found = advance(self.subject, anchor, frame, self._config, resting, begun, tries)
        belief.slide(self.hypotheses[0], found)
        self._take(anchor, found, frame)
        if self.hypotheses[0].source in LOOKED_FOR:
            orientation.facing = facing  # The pose that may have rotated is not the believed one.
        # A short step has time for one of the two; after a long one the orientation is always checked.
        short = self._apart_s <= self._config.long_step_s
        hurry = short and (tries < 1.0 or (found.tried > 0 and tries < 2.0))
        first = self.hypotheses[0]
        asked, better = belief.check_orientation(anchor, found.expected, first, frame, hurry)
        if better is not None:
            first = self._turn(better, anchor.first.log_odds, frame)
        if belief.evidence >= self._config.tracking_quality:
            orientation.see(first, frame.stamp_ns)
        return found.tried + asked

    def _look_from(self, frame: RgbdFrame) -> None:
        """Transform stored poses to the present camera axes, as for an object at rest. If the camera motion
        is unknown, they stay as they are."""
        before, (self._camera, T_new_old) = self._camera, self._camera.after(frame, self._looked_ns)
        self._looked_ns = frame.stamp_ns
        if T_new_old is None:
            if frame.T_parent_cam is not None:
                self._stood = None
        elif T_new_old is not STATIC and (not self.hypotheses or self._camera.moved is not None):
            self._carry(T_new_old)
        if self._camera.moved is None:
            # From now on velocities are relative to the camera.
            self.hypotheses = tuple(before.relative(self.subject.surface, h) for h in self.hypotheses)
        elif before.moved is None:
            self.hypotheses = tuple(replace(h, velocity=None) for h in self.hypotheses)

    def pose_if_static(self, frame: RgbdFrame) -> Float64 | None:
        """Its pose (4, 4) in the axes of a later frame if the object is at rest; None without a pose."""
        T, T_new_old = self.T_cam_obj, self._camera.after(frame, self._looked_ns)[1]
        return T if T is None or T_new_old is None else se3.compose(T_new_old, T)

    def pose_near(self, stamp_ns: int) -> Float64 | None:
        """Its pose (4, 4) at a timestamp, or else the last one that is known; None before the first."""
        there, sure = self.history.at(stamp_ns), self.belief.orientation.sure
        last = self.T_cam_obj if self.hypotheses or sure is None else sure.T_cam_obj
        return last if there is None else there

    def as_followed(self, correction: Correction) -> Float64:
        """The pose (4, 4) of a correction; of those that look the same, the one that was followed then."""
        near = self.pose_near(correction.stamp_ns)
        return correction.T_cam_obj if near is None else self.subject.like(correction.T_cam_obj, near)

    def _carry(self, T_new_old: Float64) -> None:
        """Transform it to other axes by T_new_old (4, 4)."""
        self.hypotheses = tuple(h.seen_from(T_new_old) for h in self.hypotheses)
        self.belief.seen_from(T_new_old)
        self._place = None if self._place is None else self._place.seen_from(T_new_old)
        if self.covariance is not None:
            along = se3.along(T_new_old[:3, :3])
            self.covariance = along @ self.covariance @ along.T

    def _look_everywhere(self, frame: RgbdFrame, tries: float, twins: Sequence[Float64]) -> float:
        """Look for a lost object at its last place, and search for it at the most probable place of the
        image, among other windows each time. What is found is `SUSPECT` until the next frames confirm it."""
        self._persistence = persistence = self._persistence.missed(self._apart_s)
        sure_pose = self.belief.orientation.sure
        if sure_pose is None:
            return 0
        searching = tries >= 1.0 and not persistence.resting
        in_view, returned = 0.0, False
        if self._stood is not None:
            in_view = visible_share(self.subject.surface, sure_pose.T_cam_obj, frame)
            returned = in_view > self._stood + MORE
            self._stood = min(self._stood, in_view)
        if not (searching or returned):
            return 0
        gone_s = self.belief.gone_s(frame.stamp_ns)
        usual, config, tried = self.belief.usual.remembered(gone_s), self._config, 0.0
        found: tuple[Hypothesis, ...] = ()
        free = frame.without(taken_by(self.subject.model, frame, twins)) if twins else frame
        if returned:
            found = found_at_last_place(self.subject, sure_pose, free, usual, config)
            self._stood = in_view if in_view < MOSTLY else None
        if searching and not found:
            part = 0 if persistence.enough else persistence.begun
            self._persistence = self._searched = persistence.reached(part + 1, PARTS)
            found, tried = found_elsewhere(self.subject, sure_pose, gone_s, free, usual, part, config)
        if not found:
            return tried
        anchor = Anchor((sure_pose,), frame, usual, unseen_s=gone_s)
        self.hypotheses, self.frame, first = found, frame, found[0]
        self.covariance, spread = uncertainty(self.subject, first, frame)
        self._begin()
        self.belief.find(found, spread, frame.stamp_ns)
        return tried + self.belief.check_orientation(anchor, None, first, frame, hurry=False)[0]

    def _take(self, anchor: Anchor, found: Advance, frame: RgbdFrame) -> None:
        """Give each hypothesis its log-odds, from the image, the last frame and the motion that it implies,
        and keep the best different ones."""
        belief, impossible = self.belief, self.belief.orientation.impossible
        candidates = opinions(self.subject, anchor, found, frame, self._config, impossible)
        self.hypotheses, self.frame = distinct(self.subject, candidates), frame
        belief.weigh(anchor, found, candidates, self.hypotheses, frame.stamp_ns, self._apart_s)
        if belief.evidence >= self._config.lost_quality:
            self.covariance, spread = uncertainty(self.subject, self.hypotheses[0], frame)
            belief.limit(spread)
            self._unseen_s = 0.0
        else:
            self._coast(anchor.first)
            self._unseen_s += self._apart_s
        persistence = self._persistence.missed(self._apart_s)
        persistence = persistence.reached(found.begun, END, found.tried > 0)
        self._persistence = persistence if found.doubtful else Persistence(begun=persistence.begun)
        self._place = found.place

    def _turn(self, better: Better, before: float, frame: RgbdFrame) -> Hypothesis:
        """Continue with another orientation of the followed pose. before: log-odds of the last frame. Returns
        the first hypothesis."""
        left, rest = self.hypotheses[0], self.hypotheses[1:]
        T = self.subject.like(better.pose.T_cam_obj, left.T_cam_obj)
        pose, usual = replace(better.pose, T_cam_obj=T), self.belief.usual
        first = weighed(self.subject, pose, frame, usual, before, velocity=left.velocity)
        # Their totals hardly differ; only this comparison tells the two apart.
        first = replace(first, log_odds=max(first.log_odds, left.log_odds))
        left = replace(left, log_odds=first.log_odds - SHARPNESS * better.leads)
        self.hypotheses = distinct(self.subject, [first, left, *rest])
        self.covariance, spread = uncertainty(self.subject, first, frame)
        self.belief.turn(self.hypotheses, spread, frame.stamp_ns)
        return first

    def _coast(self, before: Hypothesis) -> None:
        """Handle a frame that does not support the pose: follow the prediction if hardly anything is
        visible."""
        first, T, seconds = self.hypotheses[0], self.hypotheses[0].T_cam_obj, self._apart_s
        velocity = None if before.velocity is None else before.velocity * COASTING_DAMPING ** looks(seconds)
        if first.terms.seen < COASTING_SEEN:
            T = predicted(self.subject.surface, before.T_cam_obj, before.velocity, seconds)
        self.hypotheses = (replace(first, T_cam_obj=T, velocity=velocity), *self.hypotheses[1:])
        if self.covariance is not None:
            lever = self.subject.surface.centre_cam(T) - T[:3, 3]
            self.covariance = se3.grown(self.covariance, seconds, lever, self._unseen_s)

    def update_state(self, frame: RgbdFrame, contested: bool, since_ns: int) -> None:
        """Set state and quality from what `look` found. contested: another instance explains the same surface
        better; since_ns: poses before it are deleted from the history."""
        if self.hypotheses:
            self.belief.update(self.hypotheses[0], contested, frame.stamp_ns, self._apart_s)
            if self.belief.state is State.LOST:
                self.lose()
        self.history.append(frame.frame_id, frame.stamp_ns, self.T_cam_obj)
        self.history.forget_before(since_ns)

    def start(self, correction: Correction, frame: RgbdFrame) -> float:
        """Start from a pose of perception, in its own frame or in the nearest stored one. Returns the number
        of costly proposals used."""
        surface, belief = self.subject.surface, self.belief
        apart_s = abs(frame.stamp_ns - correction.stamp_ns) * 1e-9
        light = belief.usual.light
        found, tried = found_nearby(surface, correction.T_cam_obj, frame, apart_s, light, self._config)
        first = weighed(self.subject, found, frame, belief.usual, evidence.odds_of(correction.quality))
        self.hypotheses, self.frame = (first,), frame
        self._looked_ns, self._camera = frame.stamp_ns, self._camera.at(frame)
        self.covariance, spread = uncertainty(self.subject, first, frame)
        asked = belief.begin(first, spread, correction.quality, frame)
        known = belief.usual.baseline
        self.learn()
        if known is None and belief.usual.baseline is not None:
            # The light is known now; the baseline is the total in that light.
            lit = unmoved(surface, frame, first.T_cam_obj, belief.usual.light)
            self.hypotheses = (replace(first, terms=lit.terms),)
            belief.usual = replace(belief.usual, baseline=lit.terms.total)
        return tried + asked

    def learn(self) -> None:
        """Update the usual total and light from a believed pose."""
        self.belief.learn(self.hypotheses[0], self._apart_s)

    def place(self, verified: Track, correction: Correction, frame: RgbdFrame) -> None:
        """Take over the pose that another track of the same object, made for a correction, found in
        `frame`."""
        self.hypotheses, self.covariance = verified.hypotheses[:1], verified.covariance
        self.frame, self._looked_ns = frame, frame.stamp_ns
        self._camera = verified._camera.at(frame)
        self._begin()
        first = self.hypotheses[0]
        self.belief.take_over(verified.belief, correction, first, frame.stamp_ns, self._apart_s)

    def lose_from_view(self, seen: Track, correction: Correction) -> None:
        """Take over what another track, made for a correction, knows of the object from before the camera
        turned away. It is LOST, and looked for at its last place."""
        assert seen.frame is not None
        self.place(seen, correction, seen.frame)
        self.lose()

    def contradict(self, other: Track, quality: float) -> None:
        """Perception found the pose of another track with that quality, but this track explains more."""
        T, T_other = self.T_cam_obj, other.T_cam_obj
        fits = other.belief.evidence >= self._config.suspect_quality
        if fits and T is not None and T_other is not None and not same_pose(self.subject, T, T_other, RIGHT):
            self.belief.contradict(quality)

    def lose(self) -> None:
        """Give up its pose. If it was TRACKING before, it is searched for."""
        self.belief.lose(self.hypotheses[0] if self.hypotheses else None)
        self.hypotheses, self.covariance, self.frame = (), None, None
        self._begin()
        self._stood = 0.0

    def give_back(self) -> None:
        """Give up a pose that a search found where another instance is. The search goes on after that
        step."""
        self.lose()
        self._persistence, self._stood = self._searched, None

    def set_back(self, by_ns: int) -> None:
        """Continue at rest, as if everything before had happened that much earlier (the camera's clock was
        set back)."""
        self.history = PoseHistory(self.subject.surface.middle_obj)
        self._looked_ns -= by_ns
        self._camera = replace(self._camera, known_ns=self._camera.known_ns - by_ns)
        self.belief.set_back(by_ns)
        if self.frame is not None:
            self.frame = replace(self.frame, stamp_ns=self.frame.stamp_ns - by_ns)
        self.hypotheses = tuple(replace(h, velocity=None) for h in self.hypotheses)

    def replay(self, correction: Correction) -> None:
        """Apply a correction of a past pose; the motion measured since then moves it to the newest frame. The
        pose before the correction stays as a hypothesis that the next frames may confirm.

        Raises ValueError if the history does not reach back without a gap."""
        before = self.hypotheses[0]
        moved = self.history.replay(correction.stamp_ns, self.as_followed(correction))
        velocity = same_motion(self.subject.surface, before.velocity, before.T_cam_obj, moved)
        odds = max(evidence.odds_of(correction.quality), before.log_odds)
        corrected = replace(before, T_cam_obj=moved, velocity=velocity, source="correction", log_odds=odds)
        self.hypotheses = (corrected, before)
        self.belief.correct(before, corrected, correction)

    def agree(self, correction: Correction) -> None:
        """Perception found the same pose, independently, in a past frame."""
        if self.belief.agree(self.hypotheses[0] if self.hypotheses else None, correction):
            self.hypotheses = self.hypotheses[:1]

    def disagree(self, correction: Correction) -> None:
        """Perception found the object at the same position in another orientation, in a past frame."""
        self.belief.disagree(self.hypotheses[0] if self.hypotheses else None, correction)

    def copy(self) -> Track:
        """Another track in the same state, to go back to after a `look`; both share the history."""
        other = copy(self)
        other.belief = self.belief.copy()
        return other
