"""Injects a fault, and checks what must hold.

For every fault: before it, objects are TRACKING. No subscriber gets a pose that is not a rigid motion (it
could not be decoded), a TRACKING pose of another camera epoch, or a TRACKING pose that was older than
`tracker.max_age_ms` when it was published. A wrong pose (error over a tenth of the diameter) is TRACKING
for no more frames in a row than the evaluation of states allows the tracker to notice it. There are no more
wrong TRACKING poses than their qualities predict, which are the probabilities of being right. No other
worker dies. If the fault should be noticed, the log or the workers' health shows it. Afterwards all workers
work and objects are TRACKING again. With a slow reader, the other readers get poses as soon as before.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from huepose.evaluation.states import SUSPECT_WITHIN_FRAMES
from huepose_services.chaos.faults import Fault
from huepose_services.chaos.system import (
    LivePipeline,
    SeenPose,
    gaps_s,
    longest_wrong,
    may_be_wrong,
    too_old,
    wrong,
)

STEADY_OBJECTS = 3
_AWAY_S = 0.3
_LATER = 4.0
"""How many times later than before and after the fault a reader may get poses in the median. A computer
that is busy for a moment causes less, a queue that grows far more."""


@dataclass
class Outcome:
    """Times are seconds from the fault on; None: it did not happen. tracking_s: until TRACKING poses came
    again; 0 if they were never missing for longer than 0.3 s. broken: the checks that failed."""

    number: int
    fault: str
    noticed_s: float | None = None
    tracking_s: float | None = None
    longest_gap_s: float = 0.0
    tracking_poses: int = 0
    wrong_tracking: int = 0
    wrong_in_a_row: int = 0
    may_be_wrong: int = 0
    """How many TRACKING poses may be wrong by their quality."""
    of_no_camera: int = 0
    worst: str = ""
    """Of the TRACKING pose with the largest error: object, error over the diameter, time."""
    too_old_tracking: int = 0
    unreadable: int = 0
    others_died: int = 0
    late_ms: float = 0.0
    broken: list[str] = field(default_factory=list)


def strike(system: LivePipeline, fault: Fault, patience_s: float, steady_s: float = 2.0) -> Outcome:
    """Inject the fault, watch, end it, watch until all is well again, and check. steady_s: how long all must
    be well before."""
    outcome = Outcome(fault.number, fault.name)
    if not system.wait_until_steady(STEADY_OBJECTS, patience_s, steady_s):
        outcome.broken.append(f"before it fewer than {STEADY_OBJECTS} objects are TRACKING")
        return outcome
    calm_ms = _late_ms(system.poses[-300:])
    system.forget()
    before, log_length, refused = system.pids(), len(system.log()), system.reader.refused
    start = time.monotonic()
    with fault.strike(system) as broken:
        until = max(time.monotonic(), start) + fault.seconds
        while time.monotonic() < until or (
            fault.said and outcome.noticed_s is None and time.monotonic() < until + patience_s
        ):
            _notice(outcome, fault, system, log_length, start)
            time.sleep(0.02)
    outcome.late_ms, end = _late_ms(system.poses), time.monotonic()
    steady = system.wait_until_steady(STEADY_OBJECTS, patience_s)
    _notice(outcome, fault, system, log_length, start)
    seen = list(system.poses)
    tracking = [p for p in seen if p.state == "TRACKING"]
    outcome.longest_gap_s = max(gaps_s(seen, start, time.monotonic()))
    outcome.tracking_s = back_after(tracking, start, time.monotonic()) if steady else None
    outcome.tracking_poses = len(tracking)
    outcome.wrong_tracking, outcome.wrong_in_a_row = wrong(seen), longest_wrong(seen)
    outcome.may_be_wrong = may_be_wrong(seen)
    outcome.of_no_camera = sum(p.frame[0] not in system.epochs for p in tracking)
    worst = max(tracking, key=lambda p: p.error or 0.0, default=None)
    outcome.worst = (
        ""
        if worst is None
        else f"{worst.name} {worst.error or 0.0:.2f} after {worst.at - start:.0f} s, frame {worst.frame[1]}"
    )
    outcome.too_old_tracking = too_old(seen, system.max_age_ms)
    outcome.unreadable = 0 if fault.refused else system.reader.refused - refused
    now = system.pids()
    outcome.others_died = sum(now.get(w) != pid for w, pid in before.items() if w != fault.worker)
    # A computer that is busy during the fault is mostly busy before or after it as well.
    calm_ms = max(calm_ms, _late_ms([p for p in seen if p.at > end]))
    outcome.broken = [*broken, *_broken(outcome, fault, steady, calm_ms)]
    return outcome


def _notice(outcome: Outcome, fault: Fault, system: LivePipeline, log_length: int, start: float) -> None:
    if fault.said and outcome.noticed_s is None:
        fresh = [m for m in list(system.health.values()) if m.publish_ns > start * 1e9]
        said = " ".join([system.log()[log_length:], *(text for m in fresh for text in m.warnings)])
        if re.search(fault.said, said):
            outcome.noticed_s = time.monotonic() - start


def _broken(o: Outcome, fault: Fault, steady: bool, calm_ms: float) -> list[str]:
    found = [
        (o.unreadable > 0, f"{o.unreadable} messages of the pipeline could not be decoded"),
        (
            o.wrong_in_a_row > SUSPECT_WITHIN_FRAMES,
            f"{o.wrong_in_a_row} wrong TRACKING poses in a row (worst: {o.worst})",
        ),
        (
            o.wrong_tracking > o.may_be_wrong,
            f"{o.wrong_tracking} wrong TRACKING poses, {o.may_be_wrong} by their quality (worst: {o.worst})",
        ),
        (o.of_no_camera > 0, f"{o.of_no_camera} TRACKING poses were of another camera"),
        (o.too_old_tracking > 0, f"{o.too_old_tracking} TRACKING poses were too old"),
        (o.others_died > 0, f"{o.others_died} other workers died"),
        (bool(fault.said) and o.noticed_s is None, f"the log never said {fault.said!r}"),
        (not steady, "not all workers work and objects are TRACKING again"),
        (
            fault.number == 12 and o.late_ms > _LATER * calm_ms,
            f"others got poses after {o.late_ms:.0f} ms, without it after {calm_ms:.0f}",
        ),
    ]
    return [text for is_so, text in found if is_so]


def _late_ms(poses: Sequence[SeenPose]) -> float:
    return float(np.median([p.late_ms for p in poses])) if poses else 0.0


def back_after(tracking: Iterable[SeenPose], start: float, end: float) -> float | None:
    """When the last gap in TRACKING poses ended, in seconds from start; 0 without a gap, None if it did not
    end."""
    times = [start, *sorted({p.at for p in tracking}), end]
    away = [(a, b) for a, b in pairwise(times) if b - a > _AWAY_S]
    if not away:
        return 0.0
    return None if away[-1][1] == end else away[-1][1] - start


_HEAD = (
    "no.",
    "fault",
    "noticed",
    "TRACKING again",
    "longest without a pose",
    "TRACKING poses",
    "wrong",
    "too old",
    "held",
)


def table(outcomes: Iterable[Outcome]) -> str:
    """The table in Markdown."""
    head, *rows = (f"| {' | '.join(row)} |" for row in (_HEAD, *map(cells, outcomes)))
    return "\n".join([head, "|---" * len(_HEAD) + "|", *rows])


def cells(o: Outcome) -> tuple[str, ...]:
    """One row of the table."""

    def seconds(value: float | None) -> str:
        return "-" if value is None else "never away" if value == 0.0 else f"{value:.1f} s"

    return (
        *(str(o.number), o.fault, seconds(o.noticed_s), seconds(o.tracking_s), f"{o.longest_gap_s:.1f} s"),
        *(str(o.tracking_poses), str(o.wrong_tracking), str(o.too_old_tracking)),
        "yes" if not o.broken else "NO: " + "; ".join(o.broken),
    )
