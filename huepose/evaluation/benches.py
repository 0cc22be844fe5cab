"""How long the library takes: stages of estimation and tracking on the built-in scene, wall and CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from huepose.datasets.boxes import disturbed
from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery
from huepose.model.types import ReferenceModel
from huepose.scenes.builtin import SyntheticScene
from huepose.support.progress import progress
from huepose.support.stages import StageClock, listening
from huepose.tracking import Tracker, TrackerConfig
from huepose.tracking.types import Correction


@dataclass(frozen=True)
class StageTime:
    """Milliseconds of one stage: percentiles over repetitions; CPU time is that of the threads it ran in."""

    name: str
    wall_ms_p50: float
    wall_ms_p95: float
    wall_ms_p99: float
    cpu_ms_p50: float
    cpu_ms_p99: float

    @staticmethod
    def of(name: str, spans: Sequence[tuple[float, float]]) -> StageTime:
        """From (wall, cpu) seconds, one a repetition."""
        wall, cpu = 1000.0 * np.array(spans, dtype=np.float64).reshape(-1, 2).T
        p50, p95, p99 = np.percentile(wall, [50, 95, 99])
        return StageTime(name, *(float(x) for x in (p50, p95, p99, *np.percentile(cpu, [50, 99]))))


def bench_estimate(
    scene: SyntheticScene,
    models: Mapping[str, ReferenceModel],
    config: EstimatorConfig | None = None,
    frames: int = 12,
) -> list[StageTime]:
    """All objects of the scene in disturbed true boxes, frame by frame: `estimate` as a whole on two threads,
    then each of its stages on one, summed over the objects of a frame."""
    config = config or EstimatorConfig()
    estimator = Estimator(models, replace(config, threads=2))
    alone = Estimator(models, replace(config, threads=1))
    rows: dict[str, list[tuple[float, float]]] = {"estimate": []}
    steps = np.linspace(0, len(scene), frames + 1, endpoint=False).astype(int)
    for k, i in enumerate(progress(steps, f"estimating ({config.method})")):
        frame, queries = scene.frame(int(i)), []
        for truth in scene.truth(int(i)):
            if truth.box_visib is not None and truth.object is not None:
                size = (frame.camera.width, frame.camera.height)
                box = disturbed(truth.box_visib, "perturbed", 0, "bench", int(i), truth.instance, *size)
                queries.append(ObjectQuery(truth.object, box))
        whole = _timed(partial(estimator.estimate, frame, queries))
        with listening() as clock:
            alone.estimate(frame, queries)
        if k == 0:
            continue  # compiles, and prepares the models
        rows["estimate"].append(whole)
        _collect(rows, "estimate", clock)
    return [StageTime.of(name, spans) for name, spans in rows.items()]


def bench_track(
    scene: SyntheticScene,
    models: Mapping[str, ReferenceModel],
    config: TrackerConfig | None = None,
    frames: int = 120,
) -> list[StageTime]:
    """All objects of the scene, started from the truth, tracked through its frames: each step as a whole,
    and its stages."""
    tracker = Tracker(models, config)
    tracker.warm_up()
    first = scene.frame(0)
    for truth in scene.truth(0):
        if truth.object is not None and truth.T_cam_obj is not None:
            tracker.correct(Correction.first(truth.object, truth.T_cam_obj, first))
    rows: dict[str, list[tuple[float, float]]] = {"track": []}
    for i in progress(range(frames), "tracking"):
        frame = scene.frame(i)
        with listening() as clock:
            whole = _timed(partial(tracker.step, frame))
        if i < 3:
            continue
        rows["track"].append(whole)
        _collect(rows, "track", clock)
    return [StageTime.of(name, spans) for name, spans in rows.items()]


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def _collect(rows: dict[str, list[tuple[float, float]]], prefix: str, clock: StageClock) -> None:
    for name, total in clock.totals().items():
        rows.setdefault(f"{prefix}/{name}", []).append(total)
