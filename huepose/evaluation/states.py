"""What the states of a tracked object were worth: coverage, false TRACKING, declaring, (re)acquiring.

The words as this module measures them, on the frames of one object instance:
right: the pose is within a tenth of the diameter of the label. Visible: 30 % or more, or unknown; gone:
under 10 %. Losing support: the first gone frame, or the first of a run of frames without a right pose,
after a right one. Declared: the first frame from there on that is not TRACKING (suspect), or that has no pose
(lost). Acquired, reacquired: the first right pose; confirmed: the first right pose as TRACKING.
Coverage: TRACKING frames over visible frames, counted from a confirmation until the object is gone, so
that waiting for an object to appear is not held against the tracker but losing a visible one is.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from typing import Any

from huepose.evaluation.summary import largest

LOST_WITHIN_FRAMES = 5
SUSPECT_WITHIN_FRAMES = 2
"""An object that is gone has to be said to be LOST, and to be SUSPECT, within so many frames."""
_NO_POSE = ("LOST", "SEARCHING")


@dataclass(frozen=True)
class Moment:
    """One frame of one instance. state: as published, None where nothing was published for the frame."""

    stamp_ns: int
    visible: bool
    gone: bool
    state: str | None
    right: bool

    @property
    def supported(self) -> bool:
        """There is something to track, and the published pose is right."""
        return not self.gone and self.right


@dataclass(frozen=True)
class Loss:
    """Support was lost at frame `start` and came back at `end` (None: not before the end)."""

    start: int
    end: int | None


@dataclass(frozen=True)
class StateReport:
    """Counts and times of one instance, or summed over several (times: the largest). never_confirmed: how
    often it did not happen though the object was visible."""

    frames: int
    false_tracking_frames: int
    lost_frames: int
    tracking_frames: int
    coverable_frames: int
    visible_frames: int
    declared_suspect_after_frames: int | None
    declared_lost_after_frames: int | None
    acquired_after_s: float | None
    confirmed_after_s: float | None
    reacquired_after_s: float | None
    never_confirmed: int

    @property
    def coverage_tracking(self) -> float | None:
        """Percent; 0 for an object that was visible and never confirmed, None for one never visible."""
        if self.coverable_frames:
            return 100.0 * self.tracking_frames / self.coverable_frames
        return 0.0 if self.visible_frames else None


def report(moments: Sequence[Moment]) -> StateReport:
    """Judge the frames of one instance, in order."""
    losses = find_losses(moments)
    suspect = _largest_delay(moments, losses, ("SUSPECT", *_NO_POSE), SUSPECT_WITHIN_FRAMES)
    lost = _largest_delay(moments, losses, _NO_POSE, LOST_WITHIN_FRAMES)
    counting = coverable(moments)
    appeared = next((i for i, m in enumerate(moments) if m.visible), None)
    acquired = _first_right(moments, appeared)
    confirmed = _first_right(moments, appeared, confirmed=True)
    return StateReport(
        frames=len(moments),
        false_tracking_frames=sum(false_tracking(moments)),
        lost_frames=sum(not m.gone and m.state == "LOST" for m in moments),
        tracking_frames=sum(c and m.state == "TRACKING" for c, m in zip(counting, moments, strict=True)),
        coverable_frames=sum(counting),
        visible_frames=sum(m.visible for m in moments),
        declared_suspect_after_frames=suspect,
        declared_lost_after_frames=lost,
        acquired_after_s=_seconds(moments, appeared, acquired),
        confirmed_after_s=_seconds(moments, appeared, confirmed),
        reacquired_after_s=largest(_reacquired(moments, loss) for loss in losses),
        never_confirmed=int(appeared is not None and confirmed is None),
    )


def combined(reports: Sequence[StateReport]) -> StateReport:
    """Counts summed, times and delays the largest."""
    total: dict[str, Any] = {name: sum(getattr(r, name) for r in reports) for name in _COUNTS}
    worst = {name: largest(getattr(r, name) for r in reports) for name in TIMES}
    return StateReport(**total | worst)


TIMES = (
    "declared_suspect_after_frames",
    "declared_lost_after_frames",
    "acquired_after_s",
    "confirmed_after_s",
    "reacquired_after_s",
)
_COUNTS = tuple(field.name for field in fields(StateReport) if field.name not in TIMES)


def find_losses(moments: Sequence[Moment]) -> list[Loss]:
    """The times at which support was lost. A frame for which nothing was published decides nothing."""
    losses: list[Loss] = []
    start, had_support = None, False
    for i, moment in enumerate(moments):
        if moment.supported:
            if start is not None:
                losses.append(Loss(start, i))
            start, had_support = None, True
        elif had_support and (moment.gone or moment.state is not None):
            start, had_support = i, False
    if start is not None:
        losses.append(Loss(start, None))
    return losses


def _largest_delay(
    moments: Sequence[Moment], losses: Sequence[Loss], declaring: Collection[str], within: int
) -> int | None:
    """Frames from a loss to the first one in a declaring state. A loss that passed within its time needed no
    declaration; a longer one that was never declared counts with its length."""
    delays = []
    for loss in losses:
        end = len(moments) if loss.end is None else loss.end
        declared = next((i for i in range(loss.start, end) if moments[i].state in declaring), end)
        if declared < end or end - loss.start > within:
            delays.append(declared - loss.start)
    return max(delays, default=None)


def false_tracking(moments: Sequence[Moment]) -> list[bool]:
    """For each frame of one instance, in order: TRACKING that is wrong, or of an object that is long gone."""
    wrong, gone_for = [], 0
    for moment in moments:
        gone_for = gone_for + 1 if moment.gone else 0
        believed = gone_for <= LOST_WITHIN_FRAMES and moment.right
        wrong.append(moment.state == "TRACKING" and not believed)
    return wrong


def coverable(moments: Sequence[Moment]) -> list[bool]:
    """For each frame of one instance, in order: visible, and between a confirmation and the object's
    disappearance, so that it counts in the coverage."""
    counts, counting = [], False
    for moment in moments:
        if moment.gone:
            counting = False
        elif moment.right and moment.state == "TRACKING":
            counting = True
        counts.append(counting and moment.visible)
    return counts


def _first_right(moments: Sequence[Moment], start: int | None, *, confirmed: bool = False) -> int | None:
    if start is None:
        return None
    for i in range(start, len(moments)):
        if moments[i].supported and (not confirmed or moments[i].state == "TRACKING"):
            return i
    return None


def _reacquired(moments: Sequence[Moment], loss: Loss) -> float | None:
    """Seconds from when the object was visible again to its next right pose."""
    end = len(moments) if loss.end is None else loss.end + 1
    visible = next((i for i in range(loss.start, end) if moments[i].visible), None)
    return _seconds(moments, visible, loss.end)


def _seconds(moments: Sequence[Moment], start: int | None, end: int | None) -> float | None:
    if start is None or end is None:
        return None
    return (moments[end].stamp_ns - moments[start].stamp_ns) * 1e-9
