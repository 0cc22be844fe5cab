"""The state of one tracked instance: up to three pose hypotheses, updated by frames and by corrections."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from huepose.believe.logistic import probability
from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.judge.silhouette import taken_by
from huepose.judge.terms import NOTHING, Terms
from huepose.select.distinct import RIGHT
from huepose.tracking import evidence
from huepose.tracking.camera_place import STATIC, CameraPlace
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import PARTS
from huepose.tracking.evidence import Identity, TrackState, next_state, turned_over
from huepose.tracking.history import PoseHistory
from huepose.tracking.hypothesis import (
    FOLLOWED,
    LOOKED_FOR,
    Anchor,
    Hypothesis,
    distinct,
    same_pose,
    share_of_first,
)
from huepose.tracking.looks import LOOK_S, looks
from huepose.tracking.lost import MORE, MOSTLY, found_at_last_place, found_elsewhere, visible_share
from huepose.tracking.motion import Reach, jump_since, predicted, same_motion
from huepose.tracking.opinions import opinions, weighed
from huepose.tracking.orientation import Orientation, another_opinion
from huepose.tracking.persistence import Persistence
from huepose.tracking.refined import unmoved
from huepose.tracking.stages import END, NEARBY
from huepose.tracking.stamps import NEVER_NS
from huepose.tracking.step import Advance, advance, found_nearby
from huepose.tracking.subject import Subject
from huepose.tracking.types import Correction, Doubt
from huepose.tracking.uncertainty import FIXED, uncertainty
from huepose.tracking.usual import Usual

COASTING_SEEN = 0.15
"""If depth confirms less than this share of the surface, the predicted pose is better than the refined
one."""

COASTING_DAMPING = 0.85
"""The velocity is multiplied by this in each look that does not support the pose."""


class Track:
    """The state of one instance. In each live frame `look` finds its pose, then `update_state` sets its
    state."""

    def __init__(self, subject: Subject, object_name: str, instance: int, config: TrackerConfig) -> None:
        self.subject, self.object, self.instance = subject, object_name, instance
        self.history = PoseHistory(self.subject.surface.middle_obj)
        self.hypotheses: tuple[Hypothesis, ...] = ()
        self.covariance: Float64 | None = None
        self.quality = self.evidence = 0.0
        self.applied_seq = 0
        self.usual = Usual()
        self.frame: RgbdFrame | None = None
        self._config = config
        self._track_state = TrackState(State.SEARCHING)
        self._identity = Identity.none()
        self._corrected_from: tuple[Identity, float] | None = None
        self._orientation = Orientation(subject, config)
        self._spread, self._supported_ns, self._agreed_ns, self._found_ns = 0.0, 0, NEVER_NS, NEVER_NS
        self._looked_ns, self._apart_s = 0, LOOK_S
        self._camera = CameraPlace()
        self._known_at: tuple[Float64, int] | None = None
        self._searched = Persistence()
        self._begin()

    def _begin(self) -> None:
        """Reset the search, and the time without support."""
        self._persistence, self._scarce_looks, self._unseen_s = Persistence(), 0.0, 0.0
        self._place: Reach | None = None
        self._stood: float | None = None

    @property
    def state(self) -> State:
        """SEARCHING, TRACKING, SUSPECT or LOST."""
        return self._track_state.state

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
    def doubt(self) -> Doubt | None:
        """The one reason why its pose, which fits the frame, is not believed; None if it is believed or does
        not fit."""
        if not self.hypotheses or self.evidence < self._config.suspect_quality:
            return None
        if self._identity.value < evidence.LIKELIER or self._may_be_another:
            return Doubt.ANOTHER
        if not self._orientation.confirmed:
            return Doubt.TURN
        if not self._known:
            return Doubt.IDENTITY
        if evidence.is_loose(self._spread):
            return Doubt.LOOSE
        sure = self.quality >= self._config.least_quality
        return Doubt.FOUND if sure and self._track_state.just_found else None

    @property
    def halfway(self) -> bool:
        """Whether it has found a place that the next frame should search."""
        return self._place is not None

    @property
    def worth(self) -> float:
        """The total of its pose plus the log-odds of its orientation, in units of a total."""
        return self.terms.total + self._orientation.worth

    def look(self, frame: RgbdFrame, tries: float = np.inf, twins: Sequence[Float64] = ()) -> float:
        """Find the object in the next frame. Returns how many of at most `tries` costly proposals were used.
        twins: poses (4, 4) of other instances of the object; a lost one is not searched for there."""
        self._apart_s = (frame.stamp_ns - self._looked_ns) * 1e-9
        self._look_from(frame)
        if self.frame is None or not self.hypotheses:
            return self._look_everywhere(frame, tries, twins)
        begun = self._persistence.begun
        resting = begun == NEARBY and self._persistence.resting
        last = self.hypotheses, self.frame, self.usual
        turn_odds = 0.0 if self._orientation.facing is None else self._orientation.facing.value
        anchor = Anchor(*last, self._unseen_s, self._place, self._known, turn_odds)
        found = advance(self.subject, anchor, frame, self._config, resting, begun, tries)
        orientation, facing = self._orientation, self._orientation.facing
        orientation.slide(found.margin, self._view(), found.least_lead > 0.0)
        self._take(anchor, found, frame)
        if self.hypotheses[0].source in LOOKED_FOR:
            orientation.facing = facing  # The pose that may have rotated is not the believed one.
        # A short step has time for one of the two; after a long one the orientation is always checked.
        short = self._apart_s <= self._config.long_step_s
        hurry = short and (tries < 1.0 or (found.tried > 0 and tries < 2.0))
        tried = found.tried + self._check_orientation(anchor, found.expected, frame, hurry)
        if self.evidence >= self._config.tracking_quality:
            orientation.see(self.hypotheses[0], frame.stamp_ns)
        return tried

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

    def _carry(self, T_new_old: Float64) -> None:
        """Transform it to other axes by T_new_old (4, 4)."""
        self.hypotheses = tuple(h.seen_from(T_new_old) for h in self.hypotheses)
        self._orientation.seen_from(T_new_old)
        self._place = None if self._place is None else self._place.seen_from(T_new_old)
        if self._known_at is not None:
            self._known_at = se3.compose(T_new_old, self._known_at[0]), self._known_at[1]
        if self.covariance is not None:
            along = se3.along(T_new_old[:3, :3])
            self.covariance = along @ self.covariance @ along.T

    def _look_everywhere(self, frame: RgbdFrame, tries: float, twins: Sequence[Float64]) -> float:
        """Look for a lost object at its last place, and search for it at the most probable place of the
        image, among other windows each time. What is found is `SUSPECT` until the next frames confirm it."""
        self._persistence = persistence = self._persistence.missed(self._apart_s)
        sure_pose = self._orientation.sure
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
        gone_s = (frame.stamp_ns - self._supported_ns) * 1e-9
        usual, config, tried = self.usual.remembered(gone_s), self._config, 0.0
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
        sure = probability(found[0].log_odds) * share_of_first(self.subject, found)
        anchor = Anchor((sure_pose,), frame, usual, unseen_s=gone_s)
        self.hypotheses, self.frame, first = found, frame, found[0]
        self.covariance, self._spread = uncertainty(self.subject, first, frame)
        self.evidence = evidence.limited_by_covariance(sure, self._spread)
        self._begin()
        self._track_state = TrackState(State.SUSPECT, found=1.0)
        self._found_elsewhere(self._of_its_color(sure), frame)
        return tried + self._check_orientation(anchor, None, frame, hurry=False)

    def _take(self, anchor: Anchor, found: Advance, frame: RgbdFrame) -> None:
        """Give each hypothesis its log-odds, from the image, the last frame and the motion that it implies,
        and keep the best different ones."""
        impossible = self._orientation.impossible
        candidates = opinions(self.subject, anchor, found, frame, self._config, impossible)
        corrected = self._corrected_from
        self._corrected_from = None
        self.hypotheses = distinct(self.subject, candidates)
        first = self.hypotheses[0]
        sure = probability(first.log_odds) * share_of_first(self.subject, self.hypotheses)
        followed = anchor.known and first.source in FOLLOWED
        if evidence.one_sense(first.terms, followed) or first.jump < 0.0:
            # An implausible jump has to be confirmed by the next frame.
            sure = min(sure, evidence.ONE_SENSE)
        self._scarce_looks = (
            self._scarce_looks + looks(self._apart_s) if evidence.scarce(first.terms) else 0.0
        )
        sure = evidence.bounded(sure, self._scarce_looks)
        if (
            corrected is not None
            and len(candidates) > 1
            and first.T_cam_obj is candidates[1].T_cam_obj
            and not same_pose(self.subject, candidates[0].T_cam_obj, first.T_cam_obj, RIGHT)
        ):
            # The image prefers the pose from before the correction.
            self._identity, quality = corrected
            if probability(candidates[0].log_odds) >= self._config.suspect_quality:
                self._identity = self._identity.contradicted(quality)
        if another_opinion(self.subject, found.followed[0], first):
            self._identity = self._identity.leapt(self._view())
        self.frame, self.evidence = frame, sure
        if first.jump < 0.0 or (anchor.unseen_s > 0.0 and first.source in LOOKED_FOR):
            self._found_elsewhere(self._frame_probability(), frame)
        if sure >= self._config.lost_quality:
            self.covariance, self._spread = uncertainty(self.subject, first, frame)
            self.evidence = evidence.limited_by_covariance(sure, self._spread)
            self._unseen_s = 0.0
        else:
            self._coast(anchor.first)
            self._unseen_s += self._apart_s
        persistence = self._persistence.missed(self._apart_s)
        persistence = persistence.reached(found.begun, END, found.tried > 0)
        self._persistence = persistence if found.doubtful else Persistence(begun=persistence.begun)
        self._place = found.place

    def _found_elsewhere(self, likely: float, frame: RgbdFrame) -> None:
        """The object was found where it was not expected. likely: the probability, by this frame alone, that
        it is this object."""
        here, self._found_ns = (self.hypotheses[0].T_cam_obj, frame.stamp_ns), frame.stamp_ns
        jump = jump_since(self.subject.surface, self._known_at or here, here, self._config)
        self._identity = self._identity.found_elsewhere(likely, self._view(), jump)

    def _check_orientation(
        self, anchor: Anchor, expected: Float64 | None, frame: RgbdFrame, hurry: bool
    ) -> float:
        """Compare a pose that the frame supports with its near-symmetric rotations (`Orientation.check`);
        `hurry`: without the comparison itself. Returns the number of costly proposals used."""
        if self.evidence < self._config.lost_quality:
            return 0.0
        return self._orientation.check(anchor, expected, self.hypotheses[0], self._view(), frame, hurry)

    def update_state(self, frame: RgbdFrame, contested: bool, since_ns: int) -> None:
        """Set state and quality from what `look` found. contested: another instance explains the same surface
        better; since_ns: poses before it are deleted from the history."""
        if self.hypotheses:
            if contested:
                self.evidence = 0.0
            elif self.evidence >= self._config.suspect_quality:
                self.learn()
                self._supported_ns = frame.stamp_ns
                # The viewpoint is known only if the orientation is.
                turn_known = self._spread < FIXED and self._orientation.confirmed
                if self.evidence >= self._config.tracking_quality and turn_known:
                    self._identity = self._identity.carried(self.terms, self._view())
                if self._may_be_another:
                    self._identity = self._identity.looked_at(self._frame_probability(), self._apart_s)
            self._judge()
        self.history.append(frame.frame_id, frame.stamp_ns, self.T_cam_obj)
        self.history.forget_before(since_ns)

    def start(self, correction: Correction, frame: RgbdFrame) -> float:
        """Start from a pose of perception, in its own frame or in the nearest stored one. Returns the number
        of costly proposals used."""
        surface, light = self.subject.surface, self.usual.light
        apart_s = abs(frame.stamp_ns - correction.stamp_ns) * 1e-9
        found, searched = found_nearby(surface, correction.T_cam_obj, frame, apart_s, light, self._config)
        tried = float(searched)
        first = weighed(self.subject, found, frame, self.usual, evidence.odds_of(correction.quality))
        self.hypotheses, self.frame = (first,), frame
        self._looked_ns, self._camera = frame.stamp_ns, self._camera.at(frame)
        self.covariance, self._spread = uncertainty(self.subject, first, frame)
        sure = probability(first.log_odds)
        if evidence.one_sense(first.terms):
            sure = min(sure, evidence.ONE_SENSE)
        self.evidence = evidence.limited_by_covariance(sure, self._spread)
        if self.evidence >= self._config.tracking_quality:
            self._orientation.see(first, frame.stamp_ns)
        if self.evidence >= self._config.lost_quality:
            view = self._view()
            self._orientation.begin(correction.quality, view)
            tried += self._orientation.ask(first, view, frame, light)
        known = self.usual.baseline
        self.learn()
        if known is None and self.usual.baseline is not None:
            # The light is known now; the baseline is the total in that light.
            lit = unmoved(surface, frame, first.T_cam_obj, self.usual.light)
            self.hypotheses = (replace(first, terms=lit.terms),)
            self.usual = replace(self.usual, baseline=lit.terms.total)
        return tried

    def learn(self) -> None:
        """Update the usual total and light from a believed pose. The usual total falls only while the object
        is TRACKING: a pose that fits worse must not become the norm. A pose that may be of another object
        changes nothing."""
        baseline, tracking = self.usual.baseline, self.state is State.TRACKING
        better = baseline is None or (self.terms.total > baseline and not self._may_be_another)
        if self.evidence >= self._config.suspect_quality and (tracking or better):
            self.usual = self.usual.after(self.terms, tracking, self._apart_s)

    def place(self, verified: Track, correction: Correction, frame: RgbdFrame) -> None:
        """Take over the pose that another track of the same object, made for a correction, found in
        `frame`."""
        self.hypotheses, self.covariance = verified.hypotheses[:1], verified.covariance
        self._spread = verified._spread
        usual = verified.usual
        self.usual = replace(self.usual, baseline=usual.baseline, light=usual.light)
        self.evidence, self.frame = verified.evidence, frame
        self._looked_ns, self._camera = frame.stamp_ns, verified._camera.at(frame)
        self._orientation.take_over(verified._orientation)
        # Perception judged the same image: this evidence may lower the identity, not raise it.
        identity, there = self._identity_by(correction)
        known = self._of_its_color(
            min(identity, probability(evidence.odds_of(identity) + self._frame_log_odds))
        )
        self._identity, self._corrected_from = Identity.of(known, self._view(), there), None
        self._begin()
        self._supported_ns = frame.stamp_ns
        # A verified pose may be TRACKING at once.
        self._track_state = TrackState(State.TRACKING)
        self._judge()

    def lose_from_view(self, seen: Track, correction: Correction) -> None:
        """Take over what another track, made for a correction, knows of the object from before the camera
        turned away. It is LOST, and looked for at its last place."""
        assert seen.frame is not None
        self.place(seen, correction, seen.frame)
        self.lose()

    def contradict(self, other: Track, quality: float) -> None:
        """Perception found the pose of another track with that quality, but this track explains more."""
        T, T_other, fits = self.T_cam_obj, other.T_cam_obj, other.evidence >= self._config.suspect_quality
        if fits and T is not None and T_other is not None and not same_pose(self.subject, T, T_other, RIGHT):
            self._identity = self._identity.contradicted(quality)

    def lose(self) -> None:
        """Give up its pose. If it was TRACKING before, it is searched for."""
        if self.hypotheses and self._known_at is not None and self._orientation.sure is None:
            self._orientation.see(self.hypotheses[0], self._supported_ns)
        self._track_state = TrackState(State.LOST)
        self.hypotheses, self.covariance, self.frame = (), None, None
        self.evidence = self.quality = 0.0
        self._begin()
        self._stood = 0.0

    def give_back(self) -> None:
        """Give up a pose that a search found where another instance is. The search goes on after that
        step."""
        self.lose()
        self._persistence, self._stood = self._searched, None

    def give_way(self) -> None:
        """Another instance, found by a late correction, explains the same surface better."""
        if self.state is State.TRACKING:
            self.evidence = self.quality = 0.0
            self._track_state = TrackState(State.SUSPECT)

    def set_back(self, by_ns: int) -> None:
        """Continue at rest, as if everything before had happened that much earlier (the camera's clock was
        set back)."""
        self.history = PoseHistory(self.subject.surface.middle_obj)
        self._supported_ns, self._looked_ns = self._supported_ns - by_ns, self._looked_ns - by_ns
        self._camera = replace(self._camera, known_ns=self._camera.known_ns - by_ns)
        self._found_ns -= by_ns
        self._orientation.set_back(by_ns)
        if self._known_at is not None:
            self._known_at = self._known_at[0], self._known_at[1] - by_ns
        if self.frame is not None:
            self.frame = replace(self.frame, stamp_ns=self.frame.stamp_ns - by_ns)
        self.hypotheses = tuple(replace(h, velocity=None) for h in self.hypotheses)

    def remembered(self, stamp_ns: int) -> Usual:
        """Usual total and light from before the object was lost. The longer ago that was, the lower the
        total."""
        return self.usual.remembered((stamp_ns - self._supported_ns) * 1e-9)

    def replay(self, correction: Correction) -> None:
        """Apply a correction of a past pose; the motion measured since then moves it to the newest frame. The
        pose before the correction stays as a hypothesis that the next frames may confirm.

        Raises ValueError if the history does not reach back without a gap."""
        before = self.hypotheses[0]
        moved = self.subject.like(
            self.history.replay(correction.stamp_ns, correction.T_cam_obj), before.T_cam_obj
        )
        velocity = same_motion(self.subject.surface, before.velocity, before.T_cam_obj, moved)
        odds = max(evidence.odds_of(correction.quality), before.log_odds)
        corrected = replace(before, T_cam_obj=moved, velocity=velocity, source="correction", log_odds=odds)
        self.hypotheses, self._orientation.sure = (corrected, before), None
        self._corrected_from = self._identity, correction.quality
        if turned_over(before.T_cam_obj, moved):
            identity, there = self._identity_by(correction)
            self._identity = Identity.of(identity, self._view(), there)
            self._orientation.begin(correction.quality, self._view())
        else:
            self._identity = self._agreed(correction)
            self._orientation.assure(correction.quality)

    def agree(self, correction: Correction) -> None:
        """Perception found the same pose, independently, in a past frame. A second estimate of the same frame
        is no new evidence. An estimate of a frame before the tracker found the object elsewhere says nothing
        about that find."""
        again, self._agreed_ns = correction.stamp_ns == self._agreed_ns, correction.stamp_ns
        if self.hypotheses and not again and not self.found_since(correction.stamp_ns):
            self._identity, quality = self._agreed(correction), self._of_its_color(correction.quality)
            if quality >= evidence.LIKELIER and not self.can_have_turned_since(correction.stamp_ns):
                self.hypotheses = self.hypotheses[:1]
                if self.evidence >= self._config.suspect_quality and not self._may_be_another:
                    # The usual total is that of the newest frame, not of perception's frame.
                    self.usual = self.usual.confirmed(self.terms)
                self._orientation.assure(quality)

    def disagree(self, correction: Correction) -> None:
        """Perception found the object at the same position in another orientation, in a past frame."""
        again, self._agreed_ns = correction.stamp_ns == self._agreed_ns, correction.stamp_ns
        known = not self.found_since(correction.stamp_ns) and not self.can_have_turned_since(
            correction.stamp_ns
        )
        if self.hypotheses and not again and known:
            self._orientation.deny(self._of_its_color(correction.quality))

    def _identity_by(self, correction: Correction) -> tuple[float, float]:
        """The identity that an estimate of perception gives, and the presence. If perception is sure of the
        orientation, both are the presence. Else several poses look alike: the identity is the quality only,
        and needs another estimate."""
        there = 1.0 if correction.present is None else correction.present
        sure_of_turn = correction.present is not None and correction.quality >= self._config.confirmed_turn
        return there if sure_of_turn else correction.quality, there

    def _agreed(self, correction: Correction) -> Identity:
        """The identity after perception found the same pose by itself."""
        identity, there = self._identity_by(correction)
        return self._identity.agreed(self._of_its_color(identity), self._view(), there)

    def found_since(self, stamp_ns: int) -> bool:
        """Whether the tracker found it where it was not expected after this timestamp: the object followed
        now may be another one than before."""
        return self._found_ns > stamp_ns

    def can_have_turned_since(self, stamp_ns: int) -> bool:
        """Whether it may have made a near-symmetric rotation unnoticed after this timestamp: a pose from then
        does not tell its orientation now."""
        return self._orientation.turned_ns > stamp_ns

    def copy(self) -> Track:
        """Another track in the same state, to go back to after a `look`; both share the history."""
        other = copy(self)
        other._orientation = copy(self._orientation)
        return other

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

    def _judge(self) -> None:
        turn = self._orientation.probability
        self.quality = self.evidence * min(self._identity.value, turn)
        confirmed = self._known and self._orientation.confirmed
        confirmed = confirmed and self.quality >= self._config.least_quality
        self._track_state = next_state(
            self._track_state, self.evidence, confirmed, self._config, self._apart_s
        )
        if self.state is State.LOST:
            self.lose()
        elif self.state is State.TRACKING and self.frame is not None:
            self._known_at = self.hypotheses[0].T_cam_obj, self.frame.stamp_ns

    @property
    def _known(self) -> bool:
        """Whether the identity of the followed object is confirmed."""
        return self._identity.value >= self._config.confirmed_identity

    @property
    def _may_be_another(self) -> bool:
        """Whether it was lost and the tracker found it again by itself, not confirmed yet."""
        return self._identity.value < min(self._identity.lost, self._config.confirmed_identity)

    def _frame_probability(self) -> float:
        """The probability of its pose by this frame alone, colour included."""
        return self._of_its_color(probability(self._frame_log_odds))

    @property
    def _frame_log_odds(self) -> float:
        """Log-odds of its pose by this frame alone."""
        first, usual = self.hypotheses[0], self.usual
        return evidence.log_odds(first.terms, usual.baseline, 0.0, first.goes_on, usual.light)

    def _of_its_color(self, likely: float) -> float:
        """The probability `likely`, reduced if the colour suggests another object."""
        against = self.usual.same_color(self.terms)
        return likely if against == 0.0 else probability(evidence.odds_of(likely) + against)

    def _view(self) -> Float64:
        """The viewpoint (3,). Of viewpoints that look the same it is the one nearest to the last: a symmetric
        object shows no new side."""
        return self.subject.viewpoint(self.hypotheses[0].T_cam_obj, self._identity.view)
