"""Faults in a running pipeline: each worker killed, stopped, started twice; then garbage on every key.

    python -m benchmarks.chaos [--json FILE] [--workers camera tracker ...]

For each fault: what held before (objects TRACKING), when it was noticed, when the worker gave results again,
when poses were TRACKING again, and what subscribers saw meanwhile: the longest time without a pose message,
wrong poses and too old ones published as TRACKING, bytes that were no message. The process numbers of the
other workers must not change.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

from benchmarks.live import CHAIN, LivePipeline, SeenPose, gaps_s, too_old, wrong
from benchmarks.poison import flood

STEADY_OBJECTS = 3
_AFTER_S = 4.0
_AWAY_S = 0.3


@dataclass
class Outcome:
    """One fault. Seconds from the fault on; None: not within a minute. tracking_s: 0 when poses that may be
    acted on were never away for longer than 0.3 s."""

    worker: str
    fault: str
    steady_before: bool
    noticed_s: float | None = None
    results_s: float | None = None
    tracking_s: float | None = None
    longest_gap_s: float = 0.0
    wrong_tracking: int = 0
    too_old_tracking: int = 0
    unreadable: int = 0
    others_died: int = 0
    note: str = ""


def main() -> None:
    """Run all faults and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path)
    parser.add_argument("--workers", nargs="+", default=list(CHAIN), choices=CHAIN)
    parser.add_argument("--faults", nargs="+", default=["killed", "stopped", "twice", "poison"])
    arguments = parser.parse_args()
    outcomes = []
    with LivePipeline() as pipeline:
        if not pipeline.wait_until_steady(STEADY_OBJECTS, 240.0):
            sys.exit(f"the pipeline does not become steady:\n{pipeline.log()[-3000:]}")
        for worker in arguments.workers:
            for fault in ("killed", "stopped"):
                if fault in arguments.faults:
                    outcomes.append(_strike(pipeline, worker, fault))
                    print(_row(outcomes[-1]), flush=True)
            if "twice" in arguments.faults:
                outcomes.append(_twice(pipeline, worker))
                print(_row(outcomes[-1]), flush=True)
        if "poison" in arguments.faults:
            outcomes.append(_poison(pipeline))
            print(_row(outcomes[-1]), flush=True)
    print("\n" + table(outcomes))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(o) for o in outcomes], indent=2) + "\n")


def _strike(pipeline: LivePipeline, worker: str, fault: str) -> Outcome:
    """Kill or stop a worker and watch."""
    outcome = Outcome(worker, fault, pipeline.wait_until_steady(STEADY_OBJECTS, 60.0))
    before, log_length, refused = pipeline.pids(), len(pipeline.log()), pipeline.reader.refused
    start = time.monotonic()
    os.kill(before[worker], signal.SIGKILL if fault == "killed" else signal.SIGSTOP)
    sign = f"{worker} killed by signal" if fault == "killed" else f"{worker} has given no sign of life"
    outcome.noticed_s = _after(start, lambda: sign in pipeline.log()[log_length:])
    outcome.results_s = _after(start, lambda: _works_anew(pipeline, worker, before[worker]))
    time.sleep(_AFTER_S)
    _judge(pipeline, outcome, start, refused, before)
    return outcome


def _works_anew(pipeline: LivePipeline, worker: str, old_pid: int) -> bool:
    """Whether a new process of the worker says that it has done some work."""
    message = pipeline.health.get(worker)
    return message is not None and message.pid != old_pid and message.rate_hz > 0


def _twice(pipeline: LivePipeline, worker: str) -> Outcome:
    """Start a second instance of a worker: it has to refuse, and nobody else to notice."""
    outcome = Outcome(worker, "started twice", pipeline.wait_until_steady(STEADY_OBJECTS, 60.0))
    before, refused, start = pipeline.pids(), pipeline.reader.refused, time.monotonic()
    command = [sys.executable, "-m", "huepose_services.cli.main", "run", worker, str(pipeline.path)]
    second = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    outcome.noticed_s = time.monotonic() - start
    outcome.note = f"exit {second.returncode}: {second.stderr.strip().splitlines()[-1][:90]}"
    time.sleep(1.0)
    _judge(pipeline, outcome, start, refused, before)
    return outcome


def _poison(pipeline: LivePipeline) -> Outcome:
    """A thousand bad messages a second on every key for five seconds."""
    outcome = Outcome("all", "bad input", pipeline.wait_until_steady(STEADY_OBJECTS, 60.0))
    before, start = pipeline.pids(), time.monotonic()
    counted = {worker: message.errors for worker, message in pipeline.health.items()}
    refused = pipeline.reader.refused
    sent = flood(pipeline.endpoints, "local", "cam0", seconds=5.0, rate_hz=1000.0)
    time.sleep(2.0)
    _judge(pipeline, outcome, start, refused, before)
    errors = {worker: message.errors - counted[worker] for worker, message in pipeline.health.items()}
    outcome.note = f"{sent} sent; counted by " + ", ".join(f"{w} {n}" for w, n in errors.items() if n)
    return outcome


def _after(start: float, condition: Callable[[], bool], within_s: float = 60.0) -> float | None:
    while time.monotonic() - start < within_s:
        if condition():
            return time.monotonic() - start
        time.sleep(0.01)
    return None


def _judge(
    pipeline: LivePipeline, outcome: Outcome, start: float, refused: int, before: dict[str, int]
) -> None:
    """What subscribers saw since the fault."""
    seen = [p for p in pipeline.poses if p.at >= start]
    outcome.longest_gap_s = max(gaps_s(seen, start, time.monotonic()))
    tracking = [p for p in seen if p.state == "TRACKING"]
    outcome.tracking_s = _back_after(tracking, start, time.monotonic())
    outcome.wrong_tracking = wrong(seen)
    outcome.too_old_tracking = too_old(seen, pipeline.max_age_ms)
    outcome.unreadable = pipeline.reader.refused - refused if outcome.fault != "bad input" else 0
    now = pipeline.pids()
    outcome.others_died = sum(now[w] != pid for w, pid in before.items() if w != outcome.worker)


def _back_after(tracking: list[SeenPose], start: float, end: float) -> float | None:
    """When TRACKING poses came again after they had been away; 0 when they never were."""
    times = [start, *sorted({p.at for p in tracking}), end]
    away = [(a, b) for a, b in pairwise(times) if b - a > _AWAY_S]
    if not away:
        return 0.0
    return None if away[-1][1] == end else away[-1][1] - start


_HEAD = (
    "worker",
    "fault",
    "noticed",
    "results back",
    "TRACKING",
    "no pose for",
    "wrong",
    "old",
    "others died",
)


def _cells(o: Outcome) -> tuple[str, ...]:
    def seconds(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f} s"

    return (
        *(o.worker, o.fault, seconds(o.noticed_s), seconds(o.results_s), seconds(o.tracking_s)),
        *(f"{o.longest_gap_s:.2f} s", str(o.wrong_tracking), str(o.too_old_tracking), str(o.others_died)),
    )


def _row(o: Outcome) -> str:
    return (
        "  ".join(f"{c:>13s}" for c in _cells(o))
        + ("" if o.steady_before else "  (unsteady)")
        + f"  {o.note}"
    )


def table(outcomes: list[Outcome]) -> str:
    """As Markdown."""
    lines = [" | ".join(_HEAD), "|".join("---" for _ in _HEAD)]
    lines += [" | ".join(_cells(o)) for o in outcomes]
    return "\n".join(f"| {line} |" if "---" not in line else f"|{line}|" for line in lines)


if __name__ == "__main__":
    main()
