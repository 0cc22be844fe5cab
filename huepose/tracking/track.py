"""The state of one tracked instance: up to three pose hypotheses, updated by frames and by corrections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from huepose.believe.logistic import probability
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.uncertainty import grown
from huepose.judge.borders import outline
from huepose.judge.terms import NOTHING, Terms
from huepose.propose.relative_pose import RelativePose
from huepose.refine.ends import moved_to_ends
from huepose.tracking import evidence
from huepose.tracking.config import TrackerConfig
from huepose.tracking.elsewhere import PARTS, likeliest_place
from huepose.tracking.evidence import Standing, next_standing
from huepose.tracking.history import PoseHistory
from huepose.tracking.hypothesis import POINTS, Hypothesis, distinct, share_of_first
from huepose.tracking.identity import Identity, turned_over
from huepose.tracking.lost import found_again
from huepose.tracking.motion import filtered, increment_velocity, predicted
from huepose.tracking.reach import Reach, jump_odds, most_turned
from huepose.tracking.rival import COSTS, SHARPNESS, Facing, alike, best_rival, reached
from huepose.tracking.step import END, FLOW, Advance, Anchor, advance, found_nearby, unmoved
from huepose.tracking.subject import Subject
from huepose.tracking.types import Doubt, State, TrackedPose
from huepose.tracking.uncertainty import covariance, spread_m

COASTING_SEEN = 0.15
"""If less than this share of the surface is seen, the predicted pose is better than the refined one."""

COASTING_DAMPING = 0.85
"""The velocity is multiplied by this in each frame that does not support the pose."""

FORGOTTEN_PER_S = 0.25
"""How fast the total asked of a returning object falls, per second: the light may have changed."""

LOOSE = 0.012
"""Expected pose error, as a share of the diameter, above which the texture does not fix the pose; textured
objects have half of it."""

LOOKED_FOR = ("search", "views")
FOUND_AGAIN = (*LOOKED_FOR, "turn")
"""Sources of hypotheses found by a search instead of followed from the last frame; FOUND_AGAIN adds those
that were followed and then turned."""

MAX_TRIES = 3
TRY_AGAIN_AFTER = 15
"""After MAX_TRIES rounds without success, flow and search run only every TRY_AGAIN_AFTER doubtful frames: an
object that is half hidden for seconds must not cost more than others."""


class Track:
    """The state of one instance. In each live frame `look` finds it, then `update_state` sets its state."""

    def __init__(self, subject: Subject, object_name: str, instance: int, config: TrackerConfig) -> None:
        self.subject, self.object, self.instance = subject, object_name, instance
        self.history = PoseHistory()
        self.hypotheses: tuple[Hypothesis, ...] = ()
        self.covariance: Float64 | None = None
        self.quality = 0.0
        self.applied_seq = 0
        self.baseline: float | None = None
        self.light: Float64 | None = None
        self.frame: RgbdFrame | None = None
        self.evidence = 0.0
        self._config = config
        self._standing = Standing(State.SEARCHING)
        self._identity: Identity | None = None
        self._corrected_from: Identity | None = None
        self._facing: Facing | None = None
        self._seen: Hypothesis | None = None
        self._seen_ns = self._turned_ns = 0
        self._doubtful_frames = self._in_vain = self._begun = self._scarce_frames = 0
        self._unseen_s = 0.0
        self._supported_ns = 0
        self._place: Reach | None = None

    @property
    def state(self) -> State:
        """SEARCHING, TRACKING, SUSPECT or LOST."""
        return self._standing.state

    @property
    def T_cam_obj(self) -> Float64 | None:
        """The pose (4, 4) of the first hypothesis; None without one."""
        return self.hypotheses[0].T_cam_obj if self.hypotheses else None

    @property
    def velocity(self) -> Float64 | None:
        """Velocity (6,) of that pose: m/s, then rad/s; None if unknown."""
        return self.hypotheses[0].velocity if self.hypotheses else None

    @property
    def terms(self) -> Terms:
        """The judge's terms of that pose."""
        return self.hypotheses[0].terms if self.hypotheses else NOTHING

    @property
    def doubt(self) -> Doubt | None:
        """What alone keeps its pose from being believed; None where it is, or does not fit the frame."""
        if not self.hypotheses or self.evidence < self._config.suspect_quality:
            return None
        if self._facing is not None and self._facing.probability < self._config.confirmed_turn:
            return Doubt.TURN
        sure = self._identity is not None and self._identity.value >= self._config.confirmed_identity
        return None if sure else Doubt.IDENTITY

    @property
    def halfway(self) -> bool:
        """Whether it has found a place at which the next frame should be searched."""
        return self._place is not None

    @property
    def worth(self) -> float:
        """The total of its pose plus the certainty of its orientation, in units of a total."""
        turn = 0.0 if self._facing is None else self._facing.value / SHARPNESS
        return self.terms.total + turn

    def look(
        self,
        frame: RgbdFrame,
        relative_pose: RelativePose | None = None,
        tries: float = np.inf,
        mask: Bool | None = None,
    ) -> float:
        """Find the object in the next frame. Returns how many of at most `tries` costly proposals were used.
        mask (H, W): the object's in the last frame, if known."""
        if self.frame is None:
            return 0
        if not self.hypotheses:
            return self._look_everywhere(frame, tries)
        tried_enough = self._begun == FLOW and self._in_vain >= MAX_TRIES
        resting = tried_enough and self._doubtful_frames % TRY_AGAIN_AFTER != 0
        anchor = Anchor(
            self.hypotheses, self.frame, self.baseline, self.light, mask, self._unseen_s, self._place
        )
        found = advance(self.subject, anchor, frame, self._config, relative_pose, resting, self._begun, tries)
        known = self._facing
        if known is not None and probability(SHARPNESS * found.margin) < self._config.tracking_quality:
            # It may have rotated about its axis unnoticed.
            self._facing = known.jumped(self._view(), np.ones(len(self.subject.other_turns), bool))
        self._take(anchor, found, frame)
        if self.hypotheses[0].source in LOOKED_FOR:
            self._facing = known  # The pose that may have rotated is not the one that is believed.
        # A short step has time for one of the two; after a long one the orientation is always checked.
        short = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9 <= self._config.long_step_s
        hurry = short and (tries < 1.0 or (found.tried > 0 and tries < 2.0))
        tried = found.tried + self._check_orientation(anchor, frame, hurry)
        if self.evidence >= self._config.tracking_quality:
            self._seen, self._seen_ns = self.hypotheses[0], frame.stamp_ns
        return tried

    def _look_everywhere(self, frame: RgbdFrame, tries: float) -> float:
        """Search for a lost object, one part of the picture per frame. What is found is `SUSPECT` until the
        next frames confirm it."""
        self._doubtful_frames += 1
        resting = self._in_vain >= MAX_TRIES
        assert self.frame is not None
        if tries < 1.0 or self._seen is None or (resting and self._doubtful_frames % TRY_AGAIN_AFTER):
            return 0
        part, gone_s = 0 if resting else self._begun, (frame.stamp_ns - self._supported_ns) * 1e-9
        self._begun = (part + 1) % PARTS
        self._in_vain += self._begun == 0
        place = likeliest_place(self.subject.model, self.subject.views, frame, part)
        if place is None:
            return 1
        baseline = self.remembered(frame.stamp_ns)
        opinions = found_again(
            self.subject, self._seen, gone_s, frame, self.light, baseline, place, self._config
        )
        if not opinions:
            return 2
        sure = probability(opinions[0].log_odds) * share_of_first(opinions)
        anchor = Anchor((self._seen,), self.frame, light=self.light, unseen_s=gone_s)
        self.hypotheses, self.frame, first = opinions, frame, opinions[0]
        self.covariance, spread = self._uncertainty(first)
        self.evidence = evidence.vouched(sure, spread)
        self._doubtful_frames = self._in_vain = self._begun = self._scarce_frames = 0
        self._unseen_s = 0.0
        self._standing = Standing(State.SUSPECT, found=True)
        return 2 + self._check_orientation(anchor, frame, hurry=False)

    def _take(self, anchor: Anchor, found: Advance, frame: RgbdFrame) -> None:
        """Give each hypothesis its log-odds, from the image, its past and the motion it implies, and keep the
        best different ones."""
        surface, before = self.subject.surface, anchor.first
        seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
        opinions = [
            self._believed(h, parent.log_odds, parent, seconds, frame)
            for h, parent in zip(found.followed, anchor.hypotheses, strict=False)
        ]
        followed, gone_s = opinions[0], seconds + anchor.unseen_s
        uncertainty = self._uncertainty(followed)
        held = self._held_by_its_ends(followed, uncertainty[1], frame)
        if held is not None:
            opinions.append(self._believed(held, before.log_odds, before, seconds, frame))
        leaps: list[Float64] = []
        for h in found.proposed:
            if self._turned_too_fast(h, found.followed[0], gone_s):
                continue
            expected = predicted(before.T_cam_obj, before.velocity, seconds)
            jump = jump_odds(surface, before.T_cam_obj, expected, h.T_cam_obj, gone_s, self._config)
            opinion = self._believed(h, before.log_odds, before, seconds, frame, jump)
            # A jump, or a motion that was not seen, does not measure the velocity.
            came = jump == 0.0 and anchor.unseen_s == 0.0
            opinions.append(opinion if came else replace(opinion, velocity=None))
            leaps += [opinion.T_cam_obj] if jump < 0.0 else []
        corrected = self._corrected_from
        self._corrected_from = None
        self.hypotheses = distinct(surface, opinions)
        first = self.hypotheses[0]
        sure = probability(first.log_odds) * share_of_first(self.hypotheses)
        if evidence.one_sense(first.terms) or any(first.T_cam_obj is T for T in leaps):
            # An implausible jump has to be confirmed by the next frame.
            sure = min(sure, evidence.ONE_SENSE)
        self._scarce_frames = self._scarce_frames + 1 if evidence.scarce(first.terms) else 0
        sure = evidence.bounded(sure, self._scarce_frames)
        if corrected is not None and len(opinions) > 1 and first.T_cam_obj is opinions[1].T_cam_obj:
            self._identity = corrected  # The image prefers what was believed before the correction.
        self.frame, self.evidence = frame, sure
        if sure >= self._config.lost_quality:
            self.covariance, spread = uncertainty if first is followed else self._uncertainty(first)
            self.evidence = evidence.vouched(sure, spread)
            self._unseen_s = 0.0
        else:
            self._coast(before, seconds)
            self._unseen_s += seconds
        self._doubtful_frames = self._doubtful_frames + 1 if found.doubtful else 0
        self._in_vain = self._in_vain + (found.begun == END) if found.doubtful else 0
        self._begun, self._place = found.begun % END, found.place

    def _held_by_its_ends(self, h: Hypothesis, spread: float, frame: RgbdFrame) -> Hypothesis | None:
        """A followed pose that could slide along the object's surface, moved so that its outline fits; or
        None."""
        if spread < LOOSE and h.goes_on == 0.0:
            return None
        T = moved_to_ends(self.subject.contours, h.T_cam_obj, frame)
        if T is None:
            return None
        moved = unmoved(self.subject.surface, frame, T, self.light)
        return replace(moved, information=h.information)

    def _believed(
        self,
        h: Hypothesis,
        odds_before: float,
        parent: Hypothesis,
        seconds: float,
        frame: RgbdFrame,
        jump: float = 0.0,
    ) -> Hypothesis:
        """A hypothesis with its log-odds and filtered velocity. parent: the hypothesis it came from,
        `seconds` ago; jump: log-odds of its motion."""
        measured = increment_velocity(parent.T_cam_obj, h.T_cam_obj, seconds)
        velocity = filtered(parent.velocity, measured, seconds)
        goes_on = outline(self.subject.contours, h.T_cam_obj, frame).goes_on
        odds = evidence.log_odds(h.terms, self.baseline, odds_before, goes_on, self.light, jump)
        return replace(h, velocity=velocity, log_odds=odds, goes_on=goes_on)

    def _check_orientation(self, anchor: Anchor, frame: RgbdFrame, hurry: bool) -> float:
        """Test the pose against its near-symmetric rotations. If the object can have turned to one of them
        since it was seen last, the log-odds of its orientation drop to at most 0. Those are tested alone if
        the orientation was settled before, else all are; in a hurry none is. Returns the dear proposals that
        it took."""
        if self.evidence < self._config.lost_quality:
            return 0
        # Poses while it was in doubt may have been wrong: rotation is measured from the last sure one.
        before, since_ns = anchor.first, anchor.frame.stamp_ns
        if self._seen is not None:
            before, since_ns = self._seen, self._seen_ns
        gone_s = (frame.stamp_ns - since_ns) * 1e-9
        first, turns, view = self.hypotheses[0], self.subject.other_turns, self._view()
        T, velocity = before.T_cam_obj, before.velocity
        expected = predicted(T, velocity, gone_s)
        limit = most_turned(velocity, gone_s, self._config)
        jump = jump_odds(self.subject.surface, T, expected, first.T_cam_obj, gone_s, self._config)
        looked_for = anchor.unseen_s > 0.0 and first.source in FOUND_AGAIN
        turned_too_far = se3.rotation_angle(first.T_cam_obj, expected) > limit
        if jump < 0.0 or looked_for or turned_too_far:
            # An implausible motion, or one that was not seen: any rotation is possible.
            limit, self._turned_ns = np.pi, frame.stamp_ns
        new = reached(turns, first.T_cam_obj, expected, limit)
        facing = self._facing or Facing.of(0.5, view, len(turns))
        if new.any():
            facing = facing.jumped(view, new)
            self._seen, self._seen_ns = first, frame.stamp_ns  # This doubt is known from here on.
        self._facing = facing
        return 0.0 if hurry else self._ask(frame, anchor.light, view)

    def _turned_too_fast(self, found: Hypothesis, followed: Hypothesis, gone_s: float) -> bool:
        """Whether a proposal is about the followed pose after a near-symmetric rotation that is larger than
        the object can make in `gone_s`, while its orientation was settled. Such a proposal is dropped."""
        if self._facing is None or not self._facing.settled:
            return False
        turned = se3.rotation_angle(found.T_cam_obj, followed.T_cam_obj)
        if turned < most_turned(None, gone_s, self._config):
            return False
        return bool(alike(self.subject.other_turns, followed.T_cam_obj, found.T_cam_obj).any())

    def _ask(self, frame: RgbdFrame, light: Float64 | None, view: Float64) -> float:
        """Compare the pose with the best of the doubted near-symmetric rotations, if one may be right. view:
        as of `_view`. Returns the number of costly proposals used."""
        first = self.hypotheses[0]
        if self._facing is None or not self._facing.open(view):
            return 0
        turns = self.subject.other_turns[self._facing.doubted]
        rival = best_rival(self.subject, first, turns, frame, light)
        margin = np.inf if rival is None else first.terms.total - rival.terms.total
        self._facing = self._facing.told(margin, view)
        return COSTS if len(turns) else 0.0

    def update_state(self, frame: RgbdFrame, contested: bool = False, since_ns: int = 0) -> None:
        """Set state and quality from what `look` found. contested: another instance explains the same surface
        better; since_ns: older poses leave the history."""
        if self.hypotheses:
            if contested:
                self.evidence = 0.0
            elif self.evidence >= self._config.suspect_quality:
                # The baseline falls, and the light is learned, only while the pose is believed.
                total = self.terms.total
                if self.state is State.TRACKING or self.baseline is None or total > self.baseline:
                    self.baseline = evidence.baseline_after(self.baseline, total)
                    self.light = evidence.light_after(self.light, self.terms)
                self._supported_ns = frame.stamp_ns
                if self._identity is not None and self.evidence >= self._config.tracking_quality:
                    self._identity = self._identity.carried(self.terms, self._view())
            self._judge()
        self.history.append(frame.frame_id, frame.stamp_ns, self.T_cam_obj)
        self.history.forget_before(since_ns)

    def start(self, T_cam_obj: Float64, quality: float, frame: RgbdFrame, apart_s: float) -> float:
        """Start from a pose of perception, taken `apart_s` seconds from `frame`. Returns the number of costly
        proposals used."""
        found, searched = found_nearby(self.subject.surface, T_cam_obj, frame, apart_s, self._config)
        tried = float(searched)
        goes_on = outline(self.subject.contours, found.T_cam_obj, frame).goes_on
        odds = evidence.log_odds(found.terms, self.baseline, evidence.odds_of(quality), goes_on)
        self.hypotheses, self.frame = (replace(found, log_odds=odds, goes_on=goes_on),), frame
        self.evidence = probability(odds)
        self.covariance, _ = self._uncertainty(found)
        if self.evidence >= self._config.tracking_quality:
            self._seen, self._seen_ns = self.hypotheses[0], frame.stamp_ns
        if self.evidence >= self._config.lost_quality:
            view = self._view()
            self._facing = Facing.of(quality, view, len(self.subject.other_turns))
            tried += self._ask(frame, None, view)
        known = self.baseline
        self.learn()
        if known is None and self.baseline is not None:
            # The light is known now; the baseline is the total in that light.
            lit = unmoved(self.subject.surface, frame, found.T_cam_obj, self.light)
            self.hypotheses = (replace(self.hypotheses[0], terms=lit.terms),)
            self.baseline = lit.terms.total
        return tried

    def learn(self) -> None:
        """Update baseline and light while catching up with the present. A baseline from before the object was
        lost is not lowered: a pose that fits worse must not become the norm."""
        total = self.terms.total
        if self.evidence >= self._config.suspect_quality and (
            self.baseline is None or total >= self.baseline
        ):
            self.baseline = evidence.baseline_after(self.baseline, total)
            self.light = evidence.light_after(self.light, self.terms)

    def place(self, verified: Track, quality: float, frame: RgbdFrame) -> None:
        """Take over the pose that another track of the same object, made for a correction, found on
        `frame`."""
        self.hypotheses, self.covariance = verified.hypotheses[:1], verified.covariance
        self.baseline, self.light, self.evidence = verified.baseline, verified.light, verified.evidence
        self.frame, self._facing = frame, verified._facing
        self._seen, self._seen_ns, self._turned_ns = verified._seen, verified._seen_ns, verified._turned_ns
        first = self.hypotheses[0]
        told = evidence.log_odds(first.terms, self.baseline, 0.0, first.goes_on)
        # Perception judged the same picture: this evidence may lower its quality, not raise it.
        known = min(quality, probability(evidence.odds_of(quality) + told))
        self._identity, self._corrected_from = Identity.of(known, self._view()), None
        self._doubtful_frames = self._in_vain = self._begun = self._scarce_frames = 0
        self._unseen_s = 0.0
        self._supported_ns = frame.stamp_ns
        self._place = None
        # A verified pose may be TRACKING at once.
        self._standing = Standing(State.TRACKING)
        self._judge()

    def lose(self) -> None:
        """Give up its pose."""
        self._standing = Standing(State.LOST)
        self.hypotheses, self.covariance, self.evidence, self.quality = (), None, 0.0, 0.0
        self._doubtful_frames = self._in_vain = self._begun = 0
        self._place = None

    def set_back(self, stamp_ns: int) -> None:
        """Continue as if the last frame had this stamp (the camera's clock was set back); the velocity is
        dropped."""
        self.history = PoseHistory()
        self._supported_ns, self._seen = stamp_ns, None
        self._turned_ns = min(self._turned_ns, stamp_ns)
        if self.frame is not None and self.hypotheses:
            self.frame = replace(self.frame, stamp_ns=stamp_ns)
            self.hypotheses = tuple(replace(h, velocity=None) for h in self.hypotheses)

    def remembered(self, stamp_ns: int) -> float | None:
        """The baseline from before the object was lost, lower the longer ago that was; None without one."""
        if self.baseline is None:
            return None
        return self.baseline - FORGOTTEN_PER_S * max(0.0, (stamp_ns - self._supported_ns) * 1e-9)

    def replay(self, stamp_ns: int, T_cam_obj: Float64, quality: float) -> None:
        """Apply a correction of a past pose; the motion measured since then carries it to now. The pose
        before the correction stays as a hypothesis that the next frames may confirm.

        Raises ValueError where the history does not reach back unbroken."""
        moved = self.history.replay(stamp_ns, T_cam_obj)
        before = self.hypotheses[0]
        velocity = before.velocity
        if velocity is not None:
            # The same motion, about an origin that has moved.
            lever = moved[:3, 3] - before.T_cam_obj[:3, 3]
            velocity = np.concatenate([velocity[:3] + np.cross(velocity[3:], lever), velocity[3:]])
        odds = max(evidence.odds_of(quality), before.log_odds)
        corrected = replace(before, T_cam_obj=moved, velocity=velocity, source="correction", log_odds=odds)
        self.hypotheses, self._seen = (corrected, before), None
        self._corrected_from = self._identity
        if self._identity is None or turned_over(before.T_cam_obj, moved):
            self._identity = Identity.of(quality, self._view())
            self._facing = Facing.of(quality, self._view(), len(self.subject.other_turns))
        else:
            self._identity = self._identity.agreed(quality, self._view())
            self._assure(quality)

    def agree(self, quality: float, stamp_ns: int) -> None:
        """Perception found the same pose, independently, in the frame of that stamp."""
        if self._identity is not None and self.hypotheses:
            self._identity = self._identity.agreed(quality, self._view())
            if not self.can_have_turned_since(stamp_ns):
                self.hypotheses = self.hypotheses[:1]
                self.baseline = self.terms.total
                self._assure(quality)

    def _assure(self, quality: float) -> None:
        if self._facing is not None:
            self._facing = self._facing.assured(quality)

    def can_have_turned_since(self, stamp_ns: int) -> bool:
        """Whether it may have rotated by a near symmetry, unseen, after that stamp. Then a pose of that time
        does not fix its orientation now."""
        return self._turned_ns > stamp_ns

    def published(self, frame: RgbdFrame) -> TrackedPose:
        """The pose message for a frame."""
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

    def _coast(self, before: Hypothesis, seconds: float) -> None:
        """Handle a frame that does not support the pose: follow the prediction if hardly anything is seen."""
        first = self.hypotheses[0]
        velocity = None if before.velocity is None else before.velocity * COASTING_DAMPING
        T = first.T_cam_obj
        if first.terms.seen < COASTING_SEEN:
            T = predicted(before.T_cam_obj, before.velocity, seconds)
        self.hypotheses = (replace(first, T_cam_obj=T, velocity=velocity), *self.hypotheses[1:])
        if self.covariance is not None:
            self.covariance = grown(self.covariance, seconds)

    def _judge(self) -> None:
        identity = 0.0 if self._identity is None else self._identity.value
        turn = 1.0 if self._facing is None else self._facing.probability
        self.quality = self.evidence * min(identity, turn)
        confirmed = identity >= self._config.confirmed_identity and turn >= self._config.confirmed_turn
        confirmed = confirmed and self.quality >= self._config.least_quality
        self._standing = next_standing(self._standing, self.evidence, confirmed, self._config)
        if self.state is State.LOST:
            self.lose()

    def _view(self) -> Float64:
        """Unit vector (3,) from the object to the camera, in the object's axes."""
        T = self.hypotheses[0].T_cam_obj
        eye = -T[:3, :3].T @ self.subject.surface.centre_cam(T)
        return np.asarray(eye / max(float(np.linalg.norm(eye)), 1e-9))

    def _uncertainty(self, h: Hypothesis) -> tuple[Float64, float]:
        """Covariance (6, 6) of a pose, and its expected error as a share of the diameter."""
        surface, T = self.subject.surface, h.T_cam_obj
        known = covariance(h.information, float(surface.centre_cam(T)[2]))
        return known, spread_m(known, T, surface.arrays.points[:POINTS]) / surface.diameter_m
