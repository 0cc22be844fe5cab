"""The belief in a track's pose, and the state that follows from its quality.

The log-odds that a pose is right are a weighted sum of the judge's terms, fitted on refined poses of rendered
sequences (`believe.frame`), plus a prior from the last frame: a pose that was right is probably still right.

The identity is the probability that the followed pose was the right one to begin with. One frame cannot
decide everything: a can with a repeated texture, a box seen from a blank side. So the quality of the estimate
that started a track is kept. The doubt becomes smaller when perception agrees independently, or when the
object is seen from another viewpoint and its texture still agrees. What the tracker itself finds after a loss
may be another object, so its identity is no higher than what the frames show of it."""

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
"""If depth confirms less than LEAST_SEEN of the surface, or colour does, the pose rests on one kind of
evidence (depth or colour), and its quality is at most ONE_SENSE."""

MOST_LOOSE = 0.7
"""Highest quality of a pose that may be wrong by its own covariance: it is followed, but not TRACKING."""

OPEN = 0.1
"""If less than this share of an object is occluded, it counts as visible as a whole. Chosen on sequences of a
handle."""

HIDDEN, SCARCE_FADE = 0.6, 0.93
"""If more than HIDDEN of the surface is occluded, the quality falls by SCARCE_FADE per look."""

RETURNED_AFTER, AT_ONCE = 2, 0.95
"""Supported looks in a row after which a SUSPECT object is TRACKING again; with an evidence of AT_ONCE one
frame is enough: less than one in twenty such poses is wrong. Chosen on rendered sequences of the split
`choose`."""


def log_odds(
    terms: Terms,
    baseline: float | None,
    before: float,
    goes_on: float = 0.0,
    light: Float64 | None = None,
    jump: float = 0.0,
    unread: float = 0.0,
) -> float:
    """Log-odds that a pose is right. baseline: its usual total; before: log-odds of the pose that it was
    followed from; goes_on: share of the outline beyond which the surface continues; light (3,): the known
    light in opponent colours; jump: log-odds of its motion; unread: as in `believe.frame.features`.

    >>> from huepose.judge.terms import NOTHING
    >>> log_odds(NOTHING, None, 0.0) < -4.0
    True
    """
    x = frame.log_odds(terms, baseline, goes_on, light, unread)
    return x + max(min(MEMORY * before, MOST_MEMORY) + jump, -MOST_MEMORY)


def odds_of(p: float) -> float:
    """Log-odds of a probability, between -4.6 and 4.6 (1 % and 99 %)."""
    q = min(max(p, 0.01), 0.99)
    return log(q / (1.0 - q))


def one_sense(terms: Terms, followed: bool = False) -> bool:
    """Whether a pose rests on depth alone, or on colour alone. followed: an object of confirmed identity was
    followed to this pose. Then overexposed colours are assumed unchanged, and depth alone is enough."""
    return terms.seen < LEAST_SEEN or (terms.colored < LEAST_SEEN and not followed)


def limited_by_covariance(quality: float, spread: float) -> float:
    """A quality, limited by the uncertainty of the pose. spread: RMS displacement of the object's points by
    its covariance, as a share of the diameter. A pose is right within a tenth of the diameter.

    >>> [round(limited_by_covariance(0.99, spread), 2) for spread in (0.02, 0.05, 0.3)]
    [0.99, 0.7, 0.45]
    """
    within = erf(RIGHT / (max(spread, 1e-6) * np.sqrt(2.0)))
    most = MOST_LOOSE if is_loose(spread) else 1.0
    return min(quality, most, max(quality * within, ONE_SENSE))


def is_loose(spread: float) -> bool:
    """Whether a pose may be wrong by its own covariance: three standard deviations are more than the error of
    a right pose."""
    return spread > RIGHT / 3.0


def scarce(terms: Terms) -> bool:
    """Whether so much of the object is occluded that the rest can be followed for a moment only: a visible
    strip fits in many places along itself."""
    return terms.seen < LEAST_SEEN and terms.hidden > HIDDEN


def bounded(quality: float, scarce_looks: float) -> float:
    """A quality after this many looks in a row with little of the object visible (`scarce`)."""
    return min(quality, ONE_SENSE * SCARCE_FADE**scarce_looks) if scarce_looks else quality


@dataclass(frozen=True)
class TrackState:
    """A state. unsupported, supported: looks in a row without support, and with good support; found: the
    object was LOST and found in this frame, or, at more than 30 Hz, the part of a look that is left since
    then."""

    state: State
    unsupported: float = 0.0
    supported: float = 0.0
    found: float = 0.0

    @property
    def just_found(self) -> bool:
        """Whether all that is missing are more frames like this one."""
        return (
            self.state is State.SUSPECT
            and self.supported > 0.0
            and not enough(self.supported, RETURNED_AFTER)
        )


def next_state(
    before: TrackState, evidence: float, confirmed: bool, config: TrackerConfig, apart_s: float = LOOK_S
) -> TrackState:
    """The state after a frame. evidence: that of the pose, not its published quality; apart_s: seconds since
    the last frame; confirmed: identity and orientation are confirmed, and the published quality reaches
    `least_quality`.

    SUSPECT at once when it is not confirmed or the evidence is under `suspect_quality`; LOST after
    `lost_after` looks in a row under `lost_quality`. From SUSPECT to TRACKING after two looks in a row of at
    least `tracking_quality`, or a frame of at least AT_ONCE, unless it was found less than a look ago after a
    loss. LOST and SEARCHING do not change here.
    """
    if before.state in (State.LOST, State.SEARCHING):
        return before
    here = looks(apart_s)
    unsupported = before.unsupported + here if evidence < config.lost_quality else 0.0
    supported = before.supported + here if evidence >= config.tracking_quality else 0.0
    if evidence >= AT_ONCE and before.found <= 0.0:
        supported = max(supported, float(RETURNED_AFTER))
    if enough(unsupported, config.lost_after):
        state = State.LOST
    elif (
        evidence < config.suspect_quality
        or not confirmed
        or (before.state is State.SUSPECT and not enough(supported, RETURNED_AFTER))
    ):
        state = State.SUSPECT
    else:
        state = State.TRACKING
    return TrackState(state, unsupported, supported, max(before.found - here, 0.0))


NEW_VIEW = np.radians(25.0)
"""What a viewpoint that differs by more than this shows is new, independent evidence."""

COLOR = 0.45
"""Least agreement of the texture that counts."""

DOUBT_LEFT = 0.5
"""Share of the doubt that remains after a new viewpoint."""

LEAST_LEFT = 0.25
"""Share of the doubt of the most probable estimate that all estimates of perception from one viewpoint
together leave at least. Origin: see docs/tracking.md ("With a static camera")."""

LOOK_SHARE = 0.3
"""Weight of a look in the running mean of what the frames show of an object that the tracker found by
itself."""

LARGEST = 0.995
"""Highest identity."""

SAME_WAY = np.radians(30.0)
"""A correction that rotates the object by more shows another side of it."""


def turned_over(T_before: Float64, T_after: Float64) -> bool:
    """Whether a correction rotates the object so far that another side was taken for this one: then what was
    learnt about the old pose says nothing about the new one."""
    return bool(se3.rotation_angle(T_before, T_after) > SAME_WAY)


LIKELIER = 0.5
"""An estimate of perception with a lower quality is more likely wrong than right. It confirms nothing,
however often it is repeated."""


@dataclass(frozen=True, eq=False)
class Identity:
    """value: probability in 0..1; view (3,): direction from the object to the camera, object axes, at the
    last evidence; lost: the value before the tracker lost the object and found something by itself, else 0;
    jump: log-odds of the motion to where it was found, 0 or less; said: quality of the most probable estimate
    of perception from this viewpoint; doubt: the doubt that was left before this viewpoint; there: highest
    presence so far; 1 if none was given, or if two viewpoints confirmed the object."""

    value: float
    view: Float64
    lost: float = 0.0
    jump: float = 0.0
    said: float = 0.0
    doubt: float = 1.0
    there: float = 1.0

    @staticmethod
    def none() -> Identity:
        """Before the first estimate of perception."""
        return Identity(0.0, np.zeros(3))

    @staticmethod
    def of(quality: float, view: Float64, there: float = 1.0) -> Identity:
        """From an estimate of perception with that quality; there: its presence."""
        value = min(max(quality, 0.0), LARGEST, there)
        return Identity(value, view, said=value, there=there)

    def agreed(self, quality: float, view: Float64, there: float = 1.0) -> Identity:
        """After perception found the same pose independently; quality, there: quality and presence of its
        estimate. From the same viewpoint perception would repeat its errors. So all its estimates from
        there leave a share of the doubt about the pose, and all of the doubt about the presence. After the
        tracker found the object by itself, the first estimate decides most, however well that find fits
        the frames."""
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
        """After perception found another pose with that quality, while the image still supports this one. The
        value does not fall below 0.5 by this.

        >>> known = Identity.of(0.99, np.zeros(3))
        >>> round(known.contradicted(0.6).value, 3), known.contradicted(0.99).value
        (0.985, 0.5)
        """
        if quality < LIKELIER:
            return self
        value = probability(odds_of(self.value) - odds_of(quality))
        return replace(self, value=max(value, min(self.value, LIKELIER)))

    def carried(self, terms: Terms, view: Float64) -> Identity:
        """After a frame that supports the pose, seen from the viewpoint `view` (3,)."""
        if terms.color < COLOR or float(view @ self.view) > np.cos(NEW_VIEW):
            return self
        value = min(1.0 - (1.0 - self.value) * DOUBT_LEFT, LARGEST)
        return replace(self, value=value, view=view, jump=0.0, said=0.0, doubt=1.0 - value, there=1.0)

    def leapt(self, view: Float64) -> Identity:
        """After another pose became more probable than the followed one. The viewpoint (3,) changed with the
        decision, so it is no new viewpoint of the object."""
        return replace(self, view=view)

    def found_elsewhere(self, likely: float, view: Float64, jump: float) -> Identity:
        """After the object was lost, and the tracker found something that may be it. likely: the probability
        of that by this frame alone; jump: log-odds of the motion to there, 0 or less."""
        lost = max(self.value, self.lost)
        return Identity(min(lost, probability(odds_of(likely) + jump)), view, lost, jump)

    def looked_at(self, likely: float, apart_s: float = LOOK_S) -> Identity:
        """After another frame, `apart_s` later. likely: the probability by this frame alone. The value
        rises to that from before the loss at most. It is a running mean of log-odds, since another object
        fits now well, now badly. An impossible motion counts against it until another viewpoint confirms
        the object."""
        if self.lost == 0.0:
            return self
        seen = odds_of(likely) + self.jump
        mean = odds_of(self.value) + share(LOOK_SHARE, apart_s) * (seen - odds_of(self.value))
        return replace(self, value=min(probability(mean), self.lost))
