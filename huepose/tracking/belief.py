"""What is believed of the pose of a track, and the state and quality that follow.

Three probabilities: the *evidence* that the pose is right by what the frames show, the *identity* (it is this
object), and the *orientation* (no near-symmetric rotation of it is right). The quality is the evidence times
the smaller of the other two. Nothing here moves a pose: `tracking.track` does."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

from huepose.believe.logistic import probability
from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.select.distinct import RIGHT
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.evidence import Identity, TrackState, next_state, turned_over
from huepose.tracking.hypothesis import FOLLOWED, LOOKED_FOR, Anchor, Hypothesis, same_pose, share_of_first
from huepose.tracking.looks import looks
from huepose.tracking.motion import jump_since
from huepose.tracking.orientation import Better, Orientation, another_opinion
from huepose.tracking.stamps import NEVER_NS
from huepose.tracking.step import Advance
from huepose.tracking.subject import Subject
from huepose.tracking.types import Correction, Doubt
from huepose.tracking.uncertainty import FIXED
from huepose.tracking.usual import Usual


class Belief:
    """The belief in the first hypothesis of a track. evidence, quality: 0 to 1, 0 without a pose; usual: the
    total and light of the object so far; orientation: the belief against near-symmetric rotations.

    The methods take the first hypothesis of the track as `first`, and as `apart_s` the seconds between the
    last two frames."""

    def __init__(self, subject: Subject, config: TrackerConfig) -> None:
        self.evidence = self.quality = 0.0
        self.usual = Usual()
        self.identity = Identity.none()
        self.orientation = Orientation(subject, config)
        self._subject, self._config = subject, config
        self._track_state = TrackState(State.SEARCHING)
        self._spread = self._scarce_looks = 0.0
        self._supported_ns, self._agreed_ns, self._found_ns = 0, NEVER_NS, NEVER_NS
        self._corrected_from: tuple[Identity, float] | None = None
        self._known_at: tuple[Float64, int] | None = None

    def copy(self) -> Belief:
        """Another one that is equal and changes by itself."""
        other = copy(self)
        other.orientation = copy(self.orientation)
        return other

    @property
    def state(self) -> State:
        """SEARCHING, TRACKING, SUSPECT or LOST."""
        return self._track_state.state

    @property
    def known(self) -> bool:
        """Whether the identity of the followed object is confirmed."""
        return self.identity.value >= self._config.confirmed_identity

    @property
    def _may_be_another(self) -> bool:
        """Whether it was lost and the tracker found it again by itself, not confirmed yet."""
        return self.identity.value < min(self.identity.lost, self._config.confirmed_identity)

    @property
    def doubt(self) -> Doubt | None:
        """The one reason why a pose that fits the frame is not believed; None if it is believed or does not
        fit."""
        if self.evidence < self._config.suspect_quality:
            return None
        if self.identity.value < evidence.LIKELIER or self._may_be_another:
            return Doubt.ANOTHER
        if not self.orientation.confirmed:
            return Doubt.TURN
        if not self.known:
            return Doubt.IDENTITY
        if evidence.is_loose(self._spread):
            return Doubt.LOOSE
        sure = self.quality >= self._config.least_quality
        return Doubt.FOUND if sure and self._track_state.just_found else None

    def gone_s(self, stamp_ns: int) -> float:
        """Seconds from the last frame that supported the pose to a timestamp."""
        return (stamp_ns - self._supported_ns) * 1e-9

    def found_since(self, stamp_ns: int) -> bool:
        """Whether the tracker found it where it was not expected after this timestamp: the object followed
        now may be another one than before."""
        return self._found_ns > stamp_ns

    def can_have_turned_since(self, stamp_ns: int) -> bool:
        """Whether it may have made a near-symmetric rotation unnoticed after this timestamp: a pose from then
        does not tell its orientation now."""
        return self.orientation.turned_ns > stamp_ns

    def begin(self, first: Hypothesis, spread: float, quality: float, frame: RgbdFrame) -> float:
        """Begin with an estimate of perception of that quality. spread: as in
        `evidence.limited_by_covariance`. Returns the number of costly proposals used."""
        sure = probability(first.log_odds)
        if evidence.one_sense(first.terms):
            sure = min(sure, evidence.ONE_SENSE)
        self.evidence = sure
        self.limit(spread)
        if self.evidence >= self._config.tracking_quality:
            self.orientation.see(first, frame.stamp_ns)
        if self.evidence < self._config.lost_quality:
            return 0.0
        view = self._view(first)
        self.orientation.begin(quality, view)
        return self.orientation.ask(first, view, frame, self.usual.light)[0]

    def weigh(
        self,
        anchor: Anchor,
        found: Advance,
        candidates: Sequence[Hypothesis],
        hypotheses: Sequence[Hypothesis],
        stamp_ns: int,
        apart_s: float,
    ) -> None:
        """After a step from `anchor` in a frame. candidates: all hypotheses of it, as `opinions` returns
        them; hypotheses: those that the track keeps, best first."""
        first, config = hypotheses[0], self._config
        sure = probability(first.log_odds) * share_of_first(self._subject, hypotheses)
        followed = anchor.known and first.source in FOLLOWED
        if evidence.one_sense(first.terms, followed) or first.jump < 0.0:
            # An implausible jump has to be confirmed by the next frame.
            sure = min(sure, evidence.ONE_SENSE)
        self._scarce_looks = self._scarce_looks + looks(apart_s) if evidence.scarce(first.terms) else 0.0
        self.evidence = evidence.bounded(sure, self._scarce_looks)
        corrected, self._corrected_from = self._corrected_from, None
        if (
            corrected is not None
            and len(candidates) > 1
            and first.T_cam_obj is candidates[1].T_cam_obj
            and not same_pose(self._subject, candidates[0].T_cam_obj, first.T_cam_obj, RIGHT)
        ):
            # The image prefers the pose from before the correction.
            self.identity, quality = corrected
            if probability(candidates[0].log_odds) >= config.suspect_quality:
                self.identity = self.identity.contradicted(quality)
        if another_opinion(self._subject, found.followed[0], first):
            self.identity = self.identity.leapt(self._view(first))
        if first.jump < 0.0 or (anchor.unseen_s > 0.0 and first.source in LOOKED_FOR):
            self._find_elsewhere(first, self._frame_probability(first), stamp_ns)

    def limit(self, spread: float) -> None:
        """Limit the evidence by the uncertainty of the pose, as in `evidence.limited_by_covariance`."""
        self._spread = spread
        self.evidence = evidence.limited_by_covariance(self.evidence, spread)

    def slide(self, first: Hypothesis, found: Advance) -> None:
        """Doubt the orientation if the object may have rotated about its axis in a step (as in
        `Orientation.slide`). first: the first hypothesis before the step."""
        self.orientation.slide(found.margin, self._view(first), found.least_lead > 0.0)

    def check_orientation(
        self, anchor: Anchor, expected: Float64 | None, first: Hypothesis, frame: RgbdFrame, hurry: bool
    ) -> tuple[float, Better | None]:
        """Compare a pose that the frame supports with its near-symmetric rotations (`Orientation.check`);
        `hurry`: without the comparison itself. Returns what `Orientation.ask` does."""
        if self.evidence < self._config.lost_quality:
            return 0.0, None
        return self.orientation.check(anchor, expected, first, self._view(first), frame, hurry)

    def turn(self, hypotheses: Sequence[Hypothesis], spread: float, stamp_ns: int) -> None:
        """After another orientation of the followed pose turned out to be more probable: now the first of
        `hypotheses`."""
        first = hypotheses[0]
        sure = probability(first.log_odds) * share_of_first(self._subject, hypotheses)
        self.evidence = min(self.evidence, sure)
        self.limit(spread)
        self.orientation.turn(first, self._view(first), stamp_ns)

    def find(self, hypotheses: Sequence[Hypothesis], spread: float, stamp_ns: int) -> None:
        """After the tracker found a lost object by itself. It is SUSPECT until the next frames confirm it."""
        first = hypotheses[0]
        sure = probability(first.log_odds) * share_of_first(self._subject, hypotheses)
        self.evidence, self._scarce_looks = sure, 0.0
        self.limit(spread)
        self._track_state = TrackState(State.SUSPECT, found=1.0)
        self._find_elsewhere(first, self._of_its_color(first, sure), stamp_ns)

    def _find_elsewhere(self, first: Hypothesis, likely: float, stamp_ns: int) -> None:
        """The object was found where it was not expected. likely: the probability, by this frame alone, that
        it is this object."""
        here, self._found_ns = (first.T_cam_obj, stamp_ns), stamp_ns
        jump = jump_since(self._subject.surface, self._known_at or here, here, self._config)
        self.identity = self.identity.found_elsewhere(likely, self._view(first), jump)

    def update(self, first: Hypothesis, contested: bool, stamp_ns: int, apart_s: float) -> None:
        """Set state and quality after a frame. contested: another instance explains the same surface
        better."""
        if contested:
            self.evidence = 0.0
        elif self.evidence >= self._config.suspect_quality:
            self.learn(first, apart_s)
            self._supported_ns = stamp_ns
            # The viewpoint is known only if the orientation is.
            turn_known = self._spread < FIXED and self.orientation.confirmed
            if self.evidence >= self._config.tracking_quality and turn_known:
                self.identity = self.identity.carried(first.terms, self._view(first))
            if self._may_be_another:
                self.identity = self.identity.looked_at(self._frame_probability(first), apart_s)
        self._judge(first, stamp_ns, apart_s)

    def learn(self, first: Hypothesis, apart_s: float) -> None:
        """Update the usual total and light from a believed pose. The usual total falls only while the object
        is TRACKING: a pose that fits worse must not become the norm. A pose that may be of another object
        changes nothing."""
        baseline, tracking = self.usual.baseline, self.state is State.TRACKING
        better = baseline is None or (first.terms.total > baseline and not self._may_be_another)
        if self.evidence >= self._config.suspect_quality and (tracking or better):
            self.usual = self.usual.after(first.terms, tracking, apart_s)

    def _judge(self, first: Hypothesis, stamp_ns: int, apart_s: float) -> None:
        turn = self.orientation.probability
        self.quality = self.evidence * min(self.identity.value, turn)
        confirmed = self.known and self.orientation.confirmed
        confirmed = confirmed and self.quality >= self._config.least_quality
        self._track_state = next_state(self._track_state, self.evidence, confirmed, self._config, apart_s)
        if self.state is State.TRACKING:
            self._known_at = first.T_cam_obj, stamp_ns

    def take_over(
        self, verified: Belief, correction: Correction, first: Hypothesis, stamp_ns: int, apart_s: float
    ) -> None:
        """Continue with a pose that another track of the same object, made for a correction, verified in the
        newest frame."""
        usual = verified.usual
        self.usual = replace(self.usual, baseline=usual.baseline, light=usual.light)
        self.evidence, self._spread, self._scarce_looks = verified.evidence, verified._spread, 0.0
        self.orientation.take_over(verified.orientation)
        # Perception judged the same image: this evidence may lower the identity, not raise it.
        identity, there = self._identity_by(correction)
        by_both = probability(evidence.odds_of(identity) + self._frame_log_odds(first))
        value = self._of_its_color(first, min(identity, by_both))
        self.identity, self._corrected_from = Identity.of(value, self._view(first), there), None
        self._supported_ns = stamp_ns
        # A verified pose may be TRACKING at once.
        self._track_state = TrackState(State.TRACKING)
        self._judge(first, stamp_ns, apart_s)

    def correct(self, before: Hypothesis, first: Hypothesis, correction: Correction) -> None:
        """After a correction of a past frame replaced the pose `before` by `first`."""
        self.orientation.sure = None
        self._corrected_from = self.identity, correction.quality
        if turned_over(before.T_cam_obj, first.T_cam_obj):
            identity, there = self._identity_by(correction)
            self.identity = Identity.of(identity, self._view(first), there)
            self.orientation.begin(correction.quality, self._view(first))
        else:
            self.identity = self._agreed(first, correction)
            self.orientation.assure(correction.quality)

    def agree(self, first: Hypothesis | None, correction: Correction) -> bool:
        """Perception found the same pose, independently, in a past frame. A second estimate of the same frame
        is no new evidence. An estimate of a frame before the tracker found the object elsewhere says nothing
        about that find. Returns whether no other hypothesis needs to be kept."""
        again, self._agreed_ns = correction.stamp_ns == self._agreed_ns, correction.stamp_ns
        if first is None or again or self.found_since(correction.stamp_ns):
            return False
        self.identity, quality = (
            self._agreed(first, correction),
            self._of_its_color(first, correction.quality),
        )
        if quality < evidence.LIKELIER or self.can_have_turned_since(correction.stamp_ns):
            return False
        if self.evidence >= self._config.suspect_quality and not self._may_be_another:
            # The usual total is that of the newest frame, not of perception's frame.
            self.usual = self.usual.confirmed(first.terms)
        self.orientation.assure(quality)
        return True

    def disagree(self, first: Hypothesis | None, correction: Correction) -> None:
        """Perception found the object at the same position in another orientation, in a past frame."""
        stamp_ns = correction.stamp_ns
        again, self._agreed_ns = stamp_ns == self._agreed_ns, stamp_ns
        stale = self.found_since(stamp_ns) or self.can_have_turned_since(stamp_ns)
        if first is not None and not again and not stale:
            self.orientation.deny(self._of_its_color(first, correction.quality))

    def contradict(self, quality: float) -> None:
        """Perception found another pose with that quality, but this one explains more."""
        self.identity = self.identity.contradicted(quality)

    def give_way(self) -> None:
        """Another instance, found by a late correction, explains the same surface better."""
        if self.state is State.TRACKING:
            self.evidence = self.quality = 0.0
            self._track_state = TrackState(State.SUSPECT)

    def lose(self, first: Hypothesis | None) -> None:
        """The pose is given up. If it was TRACKING before, it is searched for."""
        if first is not None and self._known_at is not None and self.orientation.sure is None:
            self.orientation.see(first, self._supported_ns)
        self._track_state = TrackState(State.LOST)
        self.evidence = self.quality = self._scarce_looks = 0.0

    def seen_from(self, T_new_old: Float64) -> None:
        """Continue in the axes of a camera that has moved (as in `Hypothesis.seen_from`)."""
        self.orientation.seen_from(T_new_old)
        if self._known_at is not None:
            self._known_at = se3.compose(T_new_old, self._known_at[0]), self._known_at[1]

    def set_back(self, by_ns: int) -> None:
        """Continue at rest, as if everything before had happened that much earlier."""
        self._supported_ns -= by_ns
        self._found_ns -= by_ns
        self.orientation.set_back(by_ns)
        if self._known_at is not None:
            self._known_at = self._known_at[0], self._known_at[1] - by_ns

    def _identity_by(self, correction: Correction) -> tuple[float, float]:
        """The identity that an estimate of perception gives, and the presence. If perception is sure of the
        orientation, both are the presence. Else several poses look alike: the identity is the quality only,
        and needs another estimate."""
        there = 1.0 if correction.present is None else correction.present
        sure_of_turn = correction.present is not None and correction.quality >= self._config.confirmed_turn
        return there if sure_of_turn else correction.quality, there

    def _agreed(self, first: Hypothesis, correction: Correction) -> Identity:
        """The identity after perception found the same pose by itself."""
        identity, there = self._identity_by(correction)
        return self.identity.agreed(self._of_its_color(first, identity), self._view(first), there)

    def _frame_probability(self, first: Hypothesis) -> float:
        """The probability of the pose by this frame alone, colour included."""
        return self._of_its_color(first, probability(self._frame_log_odds(first)))

    def _frame_log_odds(self, first: Hypothesis) -> float:
        """Log-odds of the pose by this frame alone."""
        return evidence.log_odds(first.terms, self.usual.baseline, 0.0, first.goes_on, self.usual.light)

    def _of_its_color(self, first: Hypothesis, likely: float) -> float:
        """The probability `likely`, reduced if the colour suggests another object."""
        against = self.usual.same_color(first.terms)
        return likely if against == 0.0 else probability(evidence.odds_of(likely) + against)

    def _view(self, first: Hypothesis) -> Float64:
        """The viewpoint (3,). Of viewpoints that look the same it is the one nearest to the last: a symmetric
        object shows no new side."""
        return self._subject.viewpoint(first.T_cam_obj, self.identity.view)
