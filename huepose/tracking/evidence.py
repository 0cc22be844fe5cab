"""From what a pose explains of one frame to a quality, and from qualities to a state.

The quality is a probability that the pose is right. It is a logistic function of agreement in depth,
violation of free space and agreement of texture, fitted on refined poses of labelled frames, half of them
wrong; to that comes what is known beforehand: a pose that was right one frame ago is likely to be right
still, and one that suddenly explains the image worse than usual for this object in this light is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf

import numpy as np

from huepose.tracking.config import TrackerConfig
from huepose.tracking.scoring import Fit, Tint
from huepose.tracking.types import State

CONSTANT, PER_DEPTH_FIT, PER_BEHIND, PER_COLOR = -5.65, 3.56, -6.21, 8.95
CARRIED = 1.0
"""Log-odds that a pose gains from having been right in the last frame."""

FULLY_SEEN, BLIND_SHARE = 0.15, 0.3
"""With less of the surface confirmed in depth its colours say less: few samples correlate by chance. Surface
without a reading counts in part."""

LEAST_SEEN, ONE_SENSE = 0.15, 0.45
"""With less confirmed in depth, colours alone hold the pose; in a saturated image depth alone does. Either
way it is doubtful at best."""

HIDDEN, SCARCE_FADE = 0.6, 0.93
"""With more than this behind something, trust in the little that is left fades by this factor a frame."""

MUTE_COLOR = 0.35
"""What colours that cannot be seen neither add nor take away."""

USUAL_SLACK, HIDDEN_SLACK = 0.3, 0.3
PER_DROP = 6.0
"""Log-odds lost per score under the usual one, beyond the slack: more of it where something is in front."""

RIGHT = 0.1
"""A pose is right when its points lie off by less than this share of the diameter."""

USUAL_SHARE = 0.15
TINT_SHARE = 0.2
"""Weight of a new frame in what is usual."""

RETURNED_AFTER = 2
"""Supported frames in a row after which a SUSPECT object is TRACKING again."""


def quality(fit: Fit, usual: float | None, was_right: float) -> float:
    """Probability in 0..1 that the pose is right; was_right: the quality one frame ago.

    >>> from huepose.tracking.scoring import NOTHING
    >>> quality(NOTHING, None, 0.0) < 0.01
    True
    """
    mute = fit.tint[0] <= 0.0 and fit.seen >= FULLY_SEEN
    heard = min(1.0, (fit.seen + BLIND_SHARE * fit.no_depth) / FULLY_SEEN)
    color = MUTE_COLOR if mute else heard * fit.color
    x = CONSTANT + PER_DEPTH_FIT * fit.depth_fit + PER_BEHIND * fit.behind + PER_COLOR * color
    x += CARRIED * was_right
    if usual is not None and not mute:
        x -= PER_DROP * max(0.0, usual - fit.total - USUAL_SLACK - HIDDEN_SLACK * fit.hidden)
    q = float(1.0 / (1.0 + np.exp(-x)))
    return min(q, ONE_SENSE) if mute or fit.seen < LEAST_SEEN else q


def vouched(quality: float, spread: float) -> float:
    """A quality when the pose is that uncertain by its own covariance; spread: RMS displacement of the
    object's points as a share of its diameter. Right means within a tenth of it.

    >>> round(vouched(0.99, 0.02), 2), vouched(0.99, 0.3)
    (0.99, 0.45)
    """
    within = erf(RIGHT / (max(spread, 1e-6) * np.sqrt(2.0)))
    return min(quality, max(quality * within, ONE_SENSE))


def scarce(fit: Fit) -> bool:
    """Whether something hides so much of the object that the rest can be followed for a moment only: a strip
    of it fits in many places along itself."""
    return fit.seen < LEAST_SEEN and fit.hidden > HIDDEN


def bounded(quality: float, scarce_frames: int) -> float:
    """A quality after so many frames in a row in which there was little to follow."""
    return min(quality, ONE_SENSE * SCARCE_FADE**scarce_frames) if scarce_frames else quality


def usual_after(usual: float | None, total: float) -> float:
    """What score is usual after a supported frame."""
    return total if usual is None else usual + USUAL_SHARE * (total - usual)


def tint_after(tint: Tint, seen: Tint) -> Tint:
    """What the light does to the object's mean colour, after a supported frame."""
    if tint[0] <= 0.0:
        return seen
    if seen[0] <= 0.0:
        return tint
    a, b, c = (t + TINT_SHARE * (s - t) for t, s in zip(tint, seen, strict=True))
    return (a, b, c)


@dataclass(frozen=True)
class Standing:
    """A state, and for how many frames in a row support was missing or good."""

    state: State
    unsupported: int = 0
    supported: int = 0


def next_standing(before: Standing, quality: float, confirmed: bool, config: TrackerConfig) -> Standing:
    """The state after a frame of that quality; confirmed: the pose was the right one to begin with.

    Down at once, on the tracker's own evidence: SUSPECT under `suspect_quality`, LOST after `lost_after`
    frames under `lost_quality`. Up to TRACKING by returning evidence while SUSPECT, if confirmed; never up
    from LOST or SEARCHING.
    """
    if before.state in (State.LOST, State.SEARCHING):
        return before
    unsupported = before.unsupported + 1 if quality < config.lost_quality else 0
    supported = before.supported + 1 if quality >= config.tracking_quality else 0
    if unsupported >= config.lost_after:
        state = State.LOST
    elif (
        quality < config.suspect_quality
        or not confirmed
        or (before.state is State.SUSPECT and supported < RETURNED_AFTER)
    ):
        state = State.SUSPECT
    else:
        state = State.TRACKING
    return Standing(state, unsupported, supported)
