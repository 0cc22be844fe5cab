"""Has a stage become slower? Compares two measures of each stage with known ones.

    OMP_NUM_THREADS=1 .venv/bin/python -m benchmarks.speed [--only track estimate detect]

- Its CPU time, divided by that of fixed work: other load slows both. The minimum of many rounds counts, since
  load can only make work slower. The ratio depends on the processor, and on one kind of processor from
  machine to machine by up to 15 %.
- Its number of function calls, which is the same everywhere.

It exits with 1 if a stage needs more than ALARM times the known ratio, or MORE_CALLS times the known number
of calls. After a change that is meant to cost more or less, or on another processor, enter what is printed
in RATIOS and CALLS.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np
from llvmlite.binding import get_host_cpu_name

from benchmarks.growth import copies, picture, truth
from huepose.estimation import Estimator, ObjectQuery
from huepose.judge.silhouette import projected_box
from huepose.perception.view_detector import ViewDetector
from huepose.profiles import profile
from huepose.tracking import Tracker
from huepose.tracking.types import Correction

RATIOS = {
    "rocketlake": {"track": 2.8, "estimate": 5.0, "detect": 5.5},
    "znver3": {"track": 2.65, "estimate": 4.0, "detect": 7.1},
}
"""CPU time of ten steps with two objects, of one estimate, and of a search for two absent objects, in units
of the fixed work; by processor (LLVM's names), since the ratios differ between processors."""

CALLS = {"track": 15_600, "estimate": 6_120, "detect": 9_070}
"""Function calls of each stage, Python 3.10 and 3.11; from 3.12 on comprehensions are no calls."""

STAGES = ["track", "estimate", "detect"]

ALARM, MORE_CALLS = 1.2, 1.1
ROUNDS, MOST_ROUNDS = 8, 40
"""Least number of rounds; largest number, while there is an alarm."""

Work = Callable[[], object]


def fixed_work() -> Work:
    """Work like the library's, without any of its code: filters, products, sorting, elementary functions."""
    rng = np.random.default_rng(0)
    image = rng.random((480, 640, 3), dtype=np.float32)
    values, matrix = rng.random(60_000), rng.random((150, 150))
    places = rng.integers(0, 480 * 640, 100_000)

    def work() -> None:
        blurred = cv2.bilateralFilter(image, 5, 0.1, 3.0)
        np.sort(values)
        np.einsum("ij,jk->ik", matrix, matrix)
        np.exp(np.sqrt(values))
        blurred.reshape(-1, 3)[places].sum(0)

    return work


def stages() -> dict[str, Work]:
    """The measured stages, each on one thread."""
    models, settings = copies(4), profile("live")
    seen = dict(list(models.items())[:2])
    frames = [picture(seen, 2, i) for i in range(11)]
    poses = {name: truth(model, k, 0, 2) for k, (name, model) in enumerate(seen.items())}
    boxes = {name: projected_box(seen[name], frames[0], T) for name, T in poses.items()}
    estimator = Estimator(models, replace(settings.estimator, threads=1))
    detector = ViewDetector(models, settings.detector)
    queries, absent = [ObjectQuery(*item) for item in boxes.items()], list(models)[2:]

    def track() -> None:
        tracker = Tracker(models, settings.tracker)
        for name, T in poses.items():
            tracker.correct(Correction.first(name, T, frames[0], 1.0))
        for frame in frames[1:]:
            tracker.step(frame)

    return {
        "track": track,
        "estimate": lambda: estimator.estimate(frames[0], queries),
        "detect": lambda: detector.detect(frames[0], absent),
    }


def measured(works: Mapping[str, Work], known: Mapping[str, float]) -> dict[str, float]:
    """CPU time of each, in units of the fixed work; with more rounds while one is slower than `known`."""
    fixed = fixed_work()
    for work in works.values():
        work()
    least = dict.fromkeys([*works, ""], np.inf)
    ratios: dict[str, float] = {}
    for k in range(MOST_ROUNDS):
        for name, work in works.items():
            least[""] = min(least[""], _cpu_s(fixed))
            least[name] = min(least[name], _cpu_s(work))
        ratios = {name: least[name] / least[""] for name in works}
        if k + 1 >= ROUNDS and not slower(ratios, known):
            break
    return ratios


def called(work: Work) -> int:
    """How many functions it calls, after the first time."""
    profiler = cProfile.Profile()
    profiler.runcall(work)
    return int(pstats.Stats(profiler).total_calls)


def slowed(work: Work, share: float) -> Work:
    """The same work with `share` more CPU time."""

    def longer() -> None:
        spent_s = _cpu_s(work)
        start = time.process_time()
        while time.process_time() - start < share * spent_s:
            pass

    return longer


def slower(ratios: Mapping[str, float], known: Mapping[str, float]) -> dict[str, float]:
    """The stages that cost too much, as multiples of the known ratios; none without one."""
    return {
        name: found / known[name] for name, found in ratios.items() if found > ALARM * known.get(name, np.inf)
    }


def busier(calls: Mapping[str, int]) -> dict[str, float]:
    """The stages that call too many functions, as multiples of the known numbers."""
    return {name: n / CALLS[name] for name, n in calls.items() if n > MORE_CALLS * CALLS[name]}


def _cpu_s(work: Work) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    """Measure, print, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=STAGES, default=STAGES)
    parser.add_argument(
        "--slowed",
        type=float,
        metavar="SHARE",
        help="compare each stage with itself, slowed down by this share: would that be noticed?",
    )
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    works = {name: work for name, work in stages().items() if name in arguments.only}
    processor = get_host_cpu_name()
    known = RATIOS.get(processor, {})
    if arguments.slowed is None:
        found = measured(works, known)
    else:
        # In the same rounds: what runs beside them slows all alike.
        both = {f"{name} slowed": slowed(work, arguments.slowed) for name, work in works.items()}
        ratios = measured(works | both, {})
        known, found = ratios, {name: ratios[f"{name} slowed"] for name in works}
    calls = {name: called(work) for name, work in works.items()}
    late, busy = slower(found, known), busier(calls)
    report = {"processor": processor, "known": processor in RATIOS, "ratios": found, "slower": late}
    print(json.dumps(report | {"calls": calls, "busier": busy}))
    sys.exit(1 if late or busy else 0)


if __name__ == "__main__":
    main()
