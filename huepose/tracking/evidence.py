"""What is believed of a track, and the state that follows from its quality.

The log-odds that a pose is right are a weighted sum of the judge's terms, fitted on refined poses of drawn
sequences (`believe.frame`), plus a prior from the last frame: a pose that was right is likely still right.

The identity is how sure it is that the pose that is followed was the right one to begin with. What one frame
shows cannot settle everything: a can whose texture repeats, a box seen on a blank side. So the quality of the
estimate that started a track stays with it, and doubt shrinks when perception agrees on its own, or when the
object has been carried to another viewpoint and its texture still agrees. What the tracker itself finds after
a loss may be another thing, so it is no surer than what is seen of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import erf, log

import numpy as np

from huepose.believe import frame
from huepose.believe.logistic import probability
from huepose.believe.state import State
from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.judge.terms import Terms
from huepose.select.distinct import RIGHT
from huepose.tracking.config import TrackerConfig
from huepose.tracking.looks import LOOK_S, enough, looks, share

MEMORY, MOST_MEMORY = 0.6, 2.0
"""Share of the last frame's log-odds that is the prior of the next, and its bound: successive frames have
correlated errors."""

LEAST_SEEN, ONE_SENSE = 0.15, 0.45
"""If depth confirms less than LEAST_SEEN of the surface, or colour does, the pose rests on one sense and its
quality is at most ONE_SENSE."""

MOST_LOOSE = 0.7
"""Highest quality of a pose that may be wrong by its own covariance: it is followed and not TRACKING."""

OPEN = 0.1
"""An object of which less than this share is hidden is seen as a whole. Chosen on films of a handle."""

HIDDEN, SCARCE_FADE = 0.6, 0.93
"""If more than HIDDEN of the surface is occluded, the quality falls by SCARCE_FADE per look."""

RETURNED_AFTER, AT_ONCE = 2, 0.95
"""Supported frames in a row after which a SUSPECT object is TRACKING again; at once with that much evidence:
less than one in twenty such poses is wrong. Chosen on drawn films of the split `choose`."""


def log_odds(
    terms: Terms,
    baseline: float | None,
    before: float,
    goes_on: float = 0.0,
    light: Float64 | None = None,
    jump: float = 0.0,
    unread: float = 0.0,
) -> float:
    """Log-odds that a pose is right. baseline: its usual total; before: log-odds of the pose from which it
    was followed; goes_on: share of its outline beyond which the surface continues; light (3,): the known
    light in opponent colours; jump: log-odds of its motion; unread: as of `believe.frame.features`.

    >>> from huepose.judge.terms import NOTHING
    >>> log_odds(NOTHING, None, 0.0) < -4.0
    True

    """
    x = frame.log_odds(terms, baseline, goes_on, light, unread)
    return x + max(min(MEMORY * before, MOST_MEMORY) + jump, -MOST_MEMORY)


def odds_of(p: float) -> float:
    """Log-odds of a probability, at most 4.6 to both sides (99 %)."""
    q = min(max(p, 0.01), 0.99)
    return log(q / (1.0 - q))


def one_sense(terms: Terms, followed: bool = False) -> bool:
    """Whether a pose rests on depth alone, or on colour alone. followed: of an object that is known it was
    followed here, so colours that are overexposed now are taken to be as they were: depth tells where it
    went."""
    return terms.seen < LEAST_SEEN or (terms.colored < LEAST_SEEN and not followed)


def vouched(quality: float, spread: float) -> float:
    """A quality when the pose is that uncertain by its own covariance; spread: RMS displacement of the
    object's points as a share of its diameter. Right means within a tenth of it.

    >>> round(vouched(0.99, 0.02), 2), vouched(0.99, 0.05), vouched(0.99, 0.3)
    (0.99, 0.7, 0.45)
    """
    within = erf(RIGHT / (max(spread, 1e-6) * np.sqrt(2.0)))
    most = MOST_LOOSE if is_loose(spread) else 1.0
    return min(quality, most, max(quality * within, ONE_SENSE))


def is_loose(spread: float) -> bool:
    """Whether a pose may be wrong by its own covariance: three standard deviations are more than what is
    right."""
    return spread > RIGHT / 3.0


def scarce(terms: Terms) -> bool:
    """Whether something hides so much of the object that the rest can be followed for a moment only: a strip
    of it fits in many places along itself."""
    return terms.seen < LEAST_SEEN and terms.hidden > HIDDEN


def bounded(quality: float, scarce_looks: float) -> float:
    """A quality after so many looks in a row in which there was little to follow."""
    return min(quality, ONE_SENSE * SCARCE_FADE**scarce_looks) if scarce_looks else quality


@dataclass(frozen=True)
class TrackState:
    """A state; for how many looks in a row support was missing, for how many frames it was good; found: it
    was lost, and was found in this frame."""

    state: State
    unsupported: float = 0.0
    supported: int = 0
    found: bool = False

    @property
    def just_found(self) -> bool:
        """Whether all that is missing are more frames like this one."""
        return self.state is State.SUSPECT and 0 < self.supported < RETURNED_AFTER


def next_state(
    before: TrackState, evidence: float, confirmed: bool, config: TrackerConfig, apart_s: float = LOOK_S
) -> TrackState:
    """The state after a frame with that evidence, which is not the published quality, so many seconds after
    the last one; confirmed: identity and orientation are confirmed, and the published quality reaches
    `least_quality`.

    SUSPECT at once when it is not confirmed or the evidence is under `suspect_quality`; LOST after
    `lost_after` looks in a row under `lost_quality`. From SUSPECT to TRACKING after two frames in a row of
    at least `tracking_quality`, or one of at least AT_ONCE, unless it was lost until then;
    never up from LOST or SEARCHING.
    """
    if before.state in (State.LOST, State.SEARCHING):
        return before
    unsupported = before.unsupported + looks(apart_s) if evidence < config.lost_quality else 0.0
    supported = before.supported + 1 if evidence >= config.tracking_quality else 0
    if evidence >= AT_ONCE and not before.found:
        supported = max(supported, RETURNED_AFTER)
    if enough(unsupported, config.lost_after):
        state = State.LOST
    elif (
        evidence < config.suspect_quality
        or not confirmed
        or (before.state is State.SUSPECT and supported < RETURNED_AFTER)
    ):
        state = State.SUSPECT
    else:
        state = State.TRACKING
    return TrackState(state, unsupported, supported)


NEW_VIEW = np.radians(25.0)
"""What is seen from a viewpoint that differs by more is new, independent evidence."""

COLOR = 0.45
"""Agreement of the texture that counts."""

DOUBT_LEFT = 0.5
"""Share of the doubt that a new viewpoint leaves."""

LEAST_LEFT = 0.25
"""Share of the doubt of its surest answer that perception leaves from one viewpoint, however often it is
asked. Origin: see docs/tracking.md (before a still camera)."""

LOOK_SHARE = 0.3
"""Weight of a look in the running mean of what the tracker sees of a thing that it found by itself."""

LARGEST = 0.995
"""No belief in an identity is surer."""

SAME_WAY = np.radians(30.0)
"""A correction that turns the object further says that another side of it was seen."""


def turned_over(T_before: Float64, T_after: Float64) -> bool:
    """Whether a correction says that the object was taken for another side of itself: then what was learnt
    about the old pose says nothing about the new one."""
    return bool(se3.rotation_angle(T_before, T_after) > SAME_WAY)


LIKELIER = 0.5
"""An answer of perception of lower quality says that its pose is more likely wrong than right: it confirms
nothing, however often it is repeated."""


@dataclass(frozen=True, eq=False)
class Identity:
    """value: probability in 0..1; view (3,): direction from the object to the camera, object axes, from which
    it was last learnt; lost: the value before the tracker lost it and found something by itself, 0 where it
    did not; jump: what the motion model says of where it was found, 0 or less; said: the surest answer of
    perception from this viewpoint; doubt: what was left before it; there: how sure perception was, at best,
    that the object is there at all: 1 where nobody asked, or where two viewpoints spoke for it."""

    value: float
    view: Float64
    lost: float = 0.0
    jump: float = 0.0
    said: float = 0.0
    doubt: float = 1.0
    there: float = 1.0

    @staticmethod
    def none() -> Identity:
        """Before perception has said anything."""
        return Identity(0.0, np.zeros(3))

    @staticmethod
    def of(quality: float, view: Float64, there: float = 1.0) -> Identity:
        """Of a pose that perception is that sure of, and of the object being there."""
        value = min(max(quality, 0.0), LARGEST, there)
        return Identity(value, view, said=value, there=there)

    def agreed(self, quality: float, view: Float64, there: float = 1.0) -> Identity:
        """After perception found the same pose by itself, being that sure of it, and of the object being
        there. From the same viewpoint it would make the same mistake again, so there it leaves some of the
        doubt about the pose, and all about the object, whatever it says, and however often it says so. Of
        what the tracker found by itself its first word counts most, however like it looks."""
        if self.lost > 0.0:
            value = min(self.value, 1.0 - (1.0 - quality) * DOUBT_LEFT)
            value = min(value, quality) if quality < LIKELIER else max(value, quality)
            return Identity.of(value, view, there)
        if quality < LIKELIER:
            return self
        if float(view @ self.view) > np.cos(NEW_VIEW):
            said, there = max(self.said, quality), max(self.there, there)
            most = min(1.0 - self.doubt * (1.0 - said) * LEAST_LEFT, there)
            agreed = 1.0 - (1.0 - self.value) * max(1.0 - quality, DOUBT_LEFT)
            value = max(self.value, quality, min(agreed, most))
            return replace(self, value=min(value, LARGEST), view=view, said=said, there=there)
        value = 1.0 - (1.0 - self.value) * (1.0 - quality)
        return Identity(min(value, LARGEST), view, said=quality, doubt=1.0 - self.value)

    def contradicted(self, quality: float) -> Identity:
        """After perception found another pose, being that sure of it, while the picture goes on to speak for
        this one: at worst nobody knows.

        >>> known = Identity.of(0.99, np.zeros(3))
        >>> round(known.contradicted(0.6).value, 3), known.contradicted(0.99).value
        (0.985, 0.5)
        """
        if quality < LIKELIER:
            return self
        value = probability(odds_of(self.value) - odds_of(quality))
        return replace(self, value=max(value, min(self.value, LIKELIER)))

    def carried(self, terms: Terms, view: Float64) -> Identity:
        """After a frame that supports the pose, seen from `view`."""
        if terms.color < COLOR or float(view @ self.view) > np.cos(NEW_VIEW):
            return self
        value = min(1.0 - (1.0 - self.value) * DOUBT_LEFT, LARGEST)
        return replace(self, value=value, view=view, jump=0.0, said=0.0, doubt=1.0 - value, there=1.0)

    def leapt(self, view: Float64) -> Identity:
        """After another pose became likelier than the one that was followed: the view (3,) changed because
        the opinion did, so it is not a new one of the object."""
        return replace(self, view=view)

    def found_elsewhere(self, likely: float, view: Float64, jump: float) -> Identity:
        """After it was lost, and the tracker found what may be it; likely: the probability of that by what is
        seen there alone; jump: what the motion model says of the way there, log-odds of 0 or less."""
        lost = max(self.value, self.lost)
        return Identity(min(lost, probability(odds_of(likely) + jump)), view, lost, jump)

    def looked_at(self, likely: float, apart_s: float = LOOK_S) -> Identity:
        """After a frame, so many seconds later, that makes it that likely by itself: it may be again what it
        was before the loss, and no more. The log-odds are a running mean, since another thing fits now well,
        now badly. A jump that nothing makes counts against it until another view of it was seen."""
        if self.lost == 0.0:
            return self
        seen = odds_of(likely) + self.jump
        mean = odds_of(self.value) + share(LOOK_SHARE, apart_s) * (seen - odds_of(self.value))
        return replace(self, value=min(probability(mean), self.lost))
