"""Figures of the states of a tracked object: coverage, false TRACKING, times to report a loss and to acquire.

All figures are measured on the frames of one object instance.
Right: the pose has an error under a tenth of the diameter. Visible: 30 % or more, or unknown; gone: less than
10 %. Support is lost at the first gone frame, or at the first frame without a right pose, after a right one.
Declared: the first frame from there on that is not TRACKING (suspect), or that has no pose (lost).
Acquired, reacquired: the first right pose. Confirmed: the first right pose that is TRACKING.
Coverage: TRACKING frames divided by visible frames, counted from a confirmation until the object is gone. So
losing a visible object counts, but waiting for an object to appear does not.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from typing import Any

from huepose.evaluation.summary import largest

LOST_WITHIN_FRAMES = 5
SUSPECT_WITHIN_FRAMES = 2
"""Within these numbers of frames an object that is gone must be LOST, and SUSPECT."""
_NO_POSE = ("LOST", "SEARCHING")


@dataclass(frozen=True)
class Moment:
    """One frame of one instance. state: as published, None if nothing was published for the frame."""

    stamp_ns: int
    visible: bool
    gone: bool
    state: str | None
    right: bool

    @property
    def supported(self) -> bool:
        """The object is not gone, and the published pose is right."""
        return not self.gone and self.right


@dataclass(frozen=True)
class Loss:
    """Support was lost at frame `start` and came back at frame `end` (None: it did not come back)."""

    start: int
    end: int | None


@dataclass(frozen=True)
class StateReport:
    """Counts and times of one instance, or of several (counts summed, times the largest). never_confirmed:
    number of instances that were visible but never confirmed."""

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
        """Percent; 0 for an object that was visible but never confirmed, None for one that was never
        visible."""
        if self.coverable_frames:
            return 100.0 * self.tracking_frames / self.coverable_frames
        return 0.0 if self.visible_frames else None


def report(moments: Sequence[Moment]) -> StateReport:
    """The report on the frames of one instance, in order."""
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
    """All losses of support. A frame for which nothing was published is no loss unless the object is gone."""
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
    """Largest number of frames from a loss to the first frame in a declaring state. A loss of at most
    `within` frames need not be declared; a longer one that was never declared counts with its length."""
    delays = []
    for loss in losses:
        end = len(moments) if loss.end is None else loss.end
        declared = next((i for i in range(loss.start, end) if moments[i].state in declaring), end)
        if declared < end or end - loss.start > within:
            delays.append(declared - loss.start)
    return max(delays, default=None)


def false_tracking(moments: Sequence[Moment]) -> list[bool]:
    """For each frame of one instance, in order: it is TRACKING, but the pose is wrong, or the object has been
    gone for more than LOST_WITHIN_FRAMES."""
    wrong, gone_for = [], 0
    for moment in moments:
        gone_for = gone_for + 1 if moment.gone else 0
        believed = gone_for <= LOST_WITHIN_FRAMES and moment.right
        wrong.append(moment.state == "TRACKING" and not believed)
    return wrong


def coverable(moments: Sequence[Moment]) -> list[bool]:
    """For each frame of one instance, in order: it counts in the coverage, because the object is visible, and
    was confirmed and not gone since."""
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
    """Seconds from the first visible frame after a loss to the next right pose."""
    end = len(moments) if loss.end is None else loss.end + 1
    visible = next((i for i in range(loss.start, end) if moments[i].visible), None)
    return _seconds(moments, visible, loss.end)


def _seconds(moments: Sequence[Moment], start: int | None, end: int | None) -> float | None:
    if start is None or end is None:
        return None
    return (moments[end].stamp_ns - moments[start].stamp_ns) * 1e-9
