"""One tracked instance: up to three hypotheses of where it is, and what a frame or a correction changes about
them."""

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
from huepose.tracking.elsewhere import PARTS
from huepose.tracking.evidence import Standing, next_standing
from huepose.tracking.history import PoseHistory
from huepose.tracking.hypothesis import Hypothesis, distinct, share_of_first
from huepose.tracking.identity import Identity, turned_over
from huepose.tracking.lost import found_again
from huepose.tracking.motion import filtered, increment_velocity, predicted
from huepose.tracking.reach import jump_odds, most_turned
from huepose.tracking.rival import COSTS, SHARPNESS, Facing, alike, best_rival, reached
from huepose.tracking.step import (
    END,
    FLOW,
    Advance,
    Anchor,
    Subject,
    advance,
    found_nearby,
    unmoved,
)
from huepose.tracking.types import State, TrackedPose
from huepose.tracking.uncertainty import covariance, spread_m

COASTING_SEEN = 0.15
"""With less of the surface confirmed, the prediction is better than what was refined on it."""

COASTING_DAMPING = 0.85
"""Factor of the velocity in every frame without support."""

FORGOTTEN_PER_S = 0.25
"""Total by which less is asked, each second, of an object that returns: the light may have changed."""

LOOSE = 0.012
"""By more than this share of the diameter a pose may be off that what is inside the object does not hold: on
textured ones it is half of that."""

SPREAD_POINTS = 48
LOOKED_FOR = ("search", "views")
FOUND_AGAIN = (*LOOKED_FOR, "turn")
"""Sources of poses that were looked for where the object may be, not followed from where it was; the second
with what was followed and then turned."""

MAX_TRIES = 3
TRY_AGAIN_AFTER = 15
"""After so many times in vain flow and search rest, and are tried again every so many doubtful frames: an
object that is half hidden for seconds must not cost more than one that is not."""


class Track:
    """The state of one instance. In every live frame `look` finds it, then `update_state` judges that."""

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

    @property
    def state(self) -> State:
        """What may be believed of its pose."""
        return self._standing.state

    @property
    def T_cam_obj(self) -> Float64 | None:
        """The pose (4, 4) that is believed most, None where there is none."""
        return self.hypotheses[0].T_cam_obj if self.hypotheses else None

    @property
    def velocity(self) -> Float64 | None:
        """Of that pose (6,), a second."""
        return self.hypotheses[0].velocity if self.hypotheses else None

    @property
    def terms(self) -> Terms:
        """What is seen of that pose."""
        return self.hypotheses[0].terms if self.hypotheses else NOTHING

    @property
    def worth(self) -> float:
        """How much its pose explains, and how sure its turn is, in units of a total."""
        turn = 0.0 if self._facing is None else self._facing.value / SHARPNESS
        return self.terms.total + turn

    def look(
        self,
        frame: RgbdFrame,
        relative_pose: RelativePose | None = None,
        tries: float = np.inf,
        mask: Bool | None = None,
    ) -> float:
        """Find the object in the next frame, if it has a pose; says how many of at most `tries` dear
        proposals that took. mask (H, W): of the object in the last frame, where it is known."""
        if self.frame is None:
            return 0
        if not self.hypotheses:
            return self._look_everywhere(frame, tries)
        tried_enough = self._begun == FLOW and self._in_vain >= MAX_TRIES
        resting = tried_enough and self._doubtful_frames % TRY_AGAIN_AFTER != 0
        anchor = Anchor(self.hypotheses, self.frame, self.baseline, self.light, mask, self._unseen_s)
        found = advance(self.subject, anchor, frame, self._config, relative_pose, resting, self._begun, tries)
        known = self._facing
        if known is not None and probability(SHARPNESS * found.margin) < self._config.tracking_quality:
            # It may be slid about its axis unnoticed.
            self._facing = known.jumped(self._view(), np.ones(len(self.subject.other_turns), bool))
        self._take(anchor, found, frame)
        if self.hypotheses[0].source in LOOKED_FOR:
            self._facing = known  # What may be slid is not what is believed.
        # A short step has time for one of the two; after a long one nothing can be told without asking.
        short = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9 <= self._config.long_step_s
        hurry = short and (tries < 1.0 or (found.tried > 0 and tries < 2.0))
        tried = found.tried + self._check_orientation(anchor, frame, hurry)
        if self.evidence >= self._config.tracking_quality:
            self._seen, self._seen_ns = self.hypotheses[0], frame.stamp_ns
        return tried

    def _look_everywhere(self, frame: RgbdFrame, tries: float) -> float:
        """Look for an object that is lost, a part of the picture in each frame; what is found is `SUSPECT`
        until the next frames confirm it."""
        self._doubtful_frames += 1
        resting = self._in_vain >= MAX_TRIES
        assert self.frame is not None
        if tries < 1.0 or self._seen is None or (resting and self._doubtful_frames % TRY_AGAIN_AFTER):
            return 0
        part, gone_s = 0 if resting else self._begun, (frame.stamp_ns - self._supported_ns) * 1e-9
        baseline = self.remembered(frame.stamp_ns)
        opinions = found_again(
            self.subject, self._seen, gone_s, frame, self.light, baseline, part, self._config
        )
        self._begun = (part + 1) % PARTS
        self._in_vain += self._begun == 0
        if not opinions:
            return 1
        sure = probability(opinions[0].log_odds) * share_of_first(opinions)
        anchor = Anchor((self._seen,), self.frame, light=self.light, unseen_s=gone_s)
        self.hypotheses, self.frame, first = opinions, frame, opinions[0]
        self.covariance = self._covariance(first)
        self.evidence = evidence.vouched(sure, self._spread(first.T_cam_obj, self.covariance))
        self._doubtful_frames = self._in_vain = self._begun = self._scarce_frames = 0
        self._unseen_s = 0.0
        self._standing = Standing(State.SUSPECT)
        return 1 + self._check_orientation(anchor, frame, hurry=False)

    def _take(self, anchor: Anchor, found: Advance, frame: RgbdFrame) -> None:
        """Believe what was found as far as the image, the past and what can move so fast allow."""
        surface, before = self.subject.surface, anchor.first
        seconds = (frame.stamp_ns - anchor.frame.stamp_ns) * 1e-9
        opinions = [
            self._believed(h, parent.log_odds, parent, seconds, frame)
            for h, parent in zip(found.followed, anchor.hypotheses, strict=False)
        ]
        gone_s = seconds + anchor.unseen_s
        held = self._held_by_its_ends(opinions[0], frame)
        if held is not None:
            opinions.append(self._believed(held, before.log_odds, before, seconds, frame))
        leaps: list[Float64] = []
        for h in found.proposed:
            if self._turned_too_fast(h, found.followed[0], gone_s):
                continue
            jump = jump_odds(
                surface, before.T_cam_obj, before.velocity, h.T_cam_obj, seconds, gone_s, self._config
            )
            opinion = self._believed(h, before.log_odds, before, seconds, frame, jump)
            # What did not come here as things do, or nobody saw come, says nothing of how it moves.
            came = jump == 0.0 and anchor.unseen_s == 0.0
            opinions.append(opinion if came else replace(opinion, velocity=None))
            leaps += [opinion.T_cam_obj] if jump < 0.0 else []
        corrected = self._corrected_from
        self._corrected_from = None
        self.hypotheses = distinct(surface, opinions)
        first = self.hypotheses[0]
        sure = probability(first.log_odds) * share_of_first(self.hypotheses)
        if evidence.one_sense(first.terms) or any(first.T_cam_obj is T for T in leaps):
            # What came as nothing moves has to be seen again where it is now.
            sure = min(sure, evidence.ONE_SENSE)
        self._scarce_frames = self._scarce_frames + 1 if evidence.scarce(first.terms) else 0
        sure = evidence.bounded(sure, self._scarce_frames)
        if corrected is not None and len(opinions) > 1 and first.T_cam_obj is opinions[1].T_cam_obj:
            self._identity = corrected  # The image prefers what was believed before the correction.
        self.frame, self.evidence = frame, sure
        if sure >= self._config.lost_quality:
            self.covariance = self._covariance(first)
            self.evidence = evidence.vouched(sure, self._spread(first.T_cam_obj, self.covariance))
            self._unseen_s = 0.0
        else:
            self._coast(before, seconds)
            self._unseen_s += seconds
        self._doubtful_frames = self._doubtful_frames + 1 if found.doubtful else 0
        self._in_vain = self._in_vain + (found.begun == END) if found.doubtful else 0
        self._begun = found.begun % END

    def _held_by_its_ends(self, h: Hypothesis, frame: RgbdFrame) -> Hypothesis | None:
        """A followed pose that could be slid along its surface, moved to where the object ends."""
        if self._spread(h.T_cam_obj, self._covariance(h)) < LOOSE and h.goes_on == 0.0:
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
        """A hypothesis with its log-odds, and the velocity that led to it."""
        measured = increment_velocity(parent.T_cam_obj, h.T_cam_obj, seconds)
        velocity = filtered(parent.velocity, measured, seconds)
        goes_on = outline(self.subject.contours, h.T_cam_obj, frame).goes_on
        odds = evidence.log_odds(h.terms, self.baseline, odds_before, goes_on, jump)
        return replace(h, velocity=velocity, log_odds=odds, goes_on=goes_on)

    def _check_orientation(self, anchor: Anchor, frame: RgbdFrame, hurry: bool) -> float:
        """Test the pose against its near-symmetric rotations. If the object can have turned to one of them
        since it was seen last, the log-odds of its orientation drop to at most 0. Those are tested alone if
        the orientation was settled before, else all are; in a hurry none is. Returns the dear proposals that
        it took."""
        if self.evidence < self._config.lost_quality:
            return 0
        # What it went through while it was doubted may have been one wrong pose after another.
        before, since_ns = anchor.first, anchor.frame.stamp_ns
        if self._seen is not None:
            before, since_ns = self._seen, self._seen_ns
        gone_s = (frame.stamp_ns - since_ns) * 1e-9
        first, turns, view = self.hypotheses[0], self.subject.other_turns, self._view()
        T, velocity = before.T_cam_obj, before.velocity
        expected = predicted(T, velocity, gone_s)
        limit = most_turned(velocity, gone_s, self._config)
        jump = jump_odds(self.subject.surface, T, velocity, first.T_cam_obj, gone_s, gone_s, self._config)
        looked_for = anchor.unseen_s > 0.0 and first.source in FOUND_AGAIN
        turned_too_far = se3.rotation_angle(first.T_cam_obj, expected) > limit
        if jump < 0.0 or looked_for or turned_too_far:
            # It did not come here as things do, or nobody saw it come.
            limit, self._turned_ns = np.pi, frame.stamp_ns
        new = reached(turns, first.T_cam_obj, expected, limit)
        facing = self._facing or Facing.of(0.5, view, len(turns))
        if new.any():
            facing = facing.jumped(view, new)
            self._seen, self._seen_ns = first, frame.stamp_ns  # From here on it knows of that doubt.
        self._facing = facing
        return 0.0 if hurry else self._ask(frame, anchor.light)

    def _turned_too_fast(self, found: Hypothesis, followed: Hypothesis, gone_s: float) -> bool:
        """Whether a proposal is about the followed pose after a near-symmetric rotation that is larger than
        the object can make in `gone_s`, while its orientation was settled. Such a proposal is dropped."""
        if self._facing is None or not self._facing.settled:
            return False
        turned = se3.rotation_angle(found.T_cam_obj, followed.T_cam_obj)
        if turned < most_turned(None, gone_s, self._config):
            return False
        return bool(alike(self.subject.other_turns, followed.T_cam_obj, found.T_cam_obj).any())

    def _ask(self, frame: RgbdFrame, light: Float64 | None) -> float:
        """Judge the best of the doubted near-symmetric rotations of the pose, if one has a chance; returns
        the dear proposals that it took."""
        view, first = self._view(), self.hypotheses[0]
        if self._facing is None or not self._facing.open(view):
            return 0
        turns = self.subject.other_turns[self._facing.doubted]
        rival = best_rival(self.subject, first, turns, frame, light)
        margin = np.inf if rival is None else first.terms.total - rival.terms.total
        self._facing = self._facing.told(margin, view)
        return COSTS if len(turns) else 0.0

    def update_state(self, frame: RgbdFrame, contested: bool = False, since_ns: int = 0) -> None:
        """Judge what `look` found; contested: another pose holds the same surface with better right. Poses
        since a stamp are remembered."""
        if self.hypotheses:
            if contested:
                self.evidence = 0.0
            elif self.evidence >= self._config.suspect_quality:
                # Less becomes usual, and other light, only for a pose that is believed already.
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
        """Begin with a pose of perception that is `apart_s` seconds off `frame`; says how many dear proposals
        that took."""
        found, searched = found_nearby(self.subject.surface, T_cam_obj, frame, apart_s, self._config)
        tried = float(searched)
        goes_on = outline(self.subject.contours, found.T_cam_obj, frame).goes_on
        odds = evidence.log_odds(found.terms, self.baseline, evidence.odds_of(quality), goes_on)
        self.hypotheses, self.frame = (replace(found, log_odds=odds, goes_on=goes_on),), frame
        self.evidence = probability(odds)
        self.covariance = self._covariance(found)
        if self.evidence >= self._config.tracking_quality:
            self._seen, self._seen_ns = self.hypotheses[0], frame.stamp_ns
        if self.evidence >= self._config.lost_quality:
            self._facing = Facing.of(quality, self._view(), len(self.subject.other_turns))
            tried += self._ask(frame, None)
        known = self.baseline
        self.learn()
        if known is None and self.baseline is not None:
            # Its light is known from here on, and what is usual is what it explains in that.
            lit = unmoved(self.subject.surface, frame, found.T_cam_obj, self.light)
            self.hypotheses = (replace(self.hypotheses[0], terms=lit.terms),)
            self.baseline = lit.terms.total
        return tried

    def learn(self) -> None:
        """Take a frame that supports the pose as what is usual, on the way to now. What was usual before it
        was lost is asked for again: a pose that fits worse must not make that usual."""
        total = self.terms.total
        if self.evidence >= self._config.suspect_quality and (
            self.baseline is None or total >= self.baseline
        ):
            self.baseline = evidence.baseline_after(self.baseline, total)
            self.light = evidence.light_after(self.light, self.terms)

    def place(self, verified: Track, quality: float, frame: RgbdFrame) -> None:
        """Start, or start again, with what another track of the same object found on `frame`. Only a
        correction does this."""
        self.hypotheses, self.covariance = verified.hypotheses[:1], verified.covariance
        self.baseline, self.light, self.evidence = verified.baseline, verified.light, verified.evidence
        self.frame, self._facing = frame, verified._facing
        self._seen, self._seen_ns, self._turned_ns = verified._seen, verified._seen_ns, verified._turned_ns
        first = self.hypotheses[0]
        told = evidence.log_odds(first.terms, self.baseline, 0.0, first.goes_on)
        # What perception saw in the same picture is not seen twice: this can only speak against it.
        known = min(quality, probability(evidence.odds_of(quality) + told))
        self._identity, self._corrected_from = Identity.of(known, self._view()), None
        self._doubtful_frames = self._in_vain = self._begun = self._scarce_frames = 0
        self._unseen_s = 0.0
        self._supported_ns = frame.stamp_ns
        # A verified pose may be TRACKING at once.
        self._standing = Standing(State.TRACKING)
        self._judge()

    def lose(self) -> None:
        """Give up its pose."""
        self._standing = Standing(State.LOST)
        self.hypotheses, self.covariance, self.evidence, self.quality = (), None, 0.0, 0.0
        self._doubtful_frames = self._in_vain = self._begun = 0

    def set_back(self, stamp_ns: int) -> None:
        """Go on as if the last frame had that stamp; how it moved before is not known."""
        self.history = PoseHistory()
        self._supported_ns, self._seen = stamp_ns, None
        self._turned_ns = min(self._turned_ns, stamp_ns)
        if self.frame is not None and self.hypotheses:
            self.frame = replace(self.frame, stamp_ns=stamp_ns)
            self.hypotheses = tuple(replace(h, velocity=None) for h in self.hypotheses)

    def remembered(self, stamp_ns: int) -> float | None:
        """The baseline from before the object was lost; the older, the less it asks for."""
        if self.baseline is None:
            return None
        return self.baseline - FORGOTTEN_PER_S * max(0.0, (stamp_ns - self._supported_ns) * 1e-9)

    def replay(self, stamp_ns: int, T_cam_obj: Float64, quality: float) -> None:
        """Take a correction of a kept pose: the increments since then carry it to now. What was believed
        before stays a hypothesis, and comes back if the next frames say so.

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
        """Perception found the same pose by itself in the frame of that stamp."""
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
        """Whether it can have turned into a near-symmetric rotation after that stamp: what was true then
        does not say which way round it is now."""
        return self._turned_ns > stamp_ns

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

    def _coast(self, before: Hypothesis, seconds: float) -> None:
        """A frame that does not support the pose: keep to the prediction where hardly anything is seen."""
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
        confirmed = min(identity, turn) >= self._config.confirmed_identity
        self._standing = next_standing(self._standing, self.evidence, confirmed, self._config)
        if self.state is State.LOST:
            self.lose()

    def _view(self) -> Float64:
        """Direction (3,) from the object to the camera, object axes."""
        T = self.hypotheses[0].T_cam_obj
        eye = -T[:3, :3].T @ self.subject.surface.centre_cam(T)
        return np.asarray(eye / max(float(np.linalg.norm(eye)), 1e-9))

    def _spread(self, T_cam_obj: Float64, covariance: Float64) -> float:
        """By how much a pose may be off, as a share of the diameter."""
        surface = self.subject.surface
        return spread_m(covariance, T_cam_obj, surface.arrays.points[:SPREAD_POINTS]) / surface.diameter_m

    def _covariance(self, h: Hypothesis) -> Float64:
        return covariance(h.information, float(self.subject.surface.centre_cam(h.T_cam_obj)[2]))
