"""Computing time of the library on the built-in scene: stages of perception, estimation and tracking."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from huepose.datasets.boxes import disturbed
from huepose.datasets.types import GroundTruth
from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery, PosePrior
from huepose.estimation.answer import looks_in_full
from huepose.geometry import se3
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.config import DetectorConfig
from huepose.perception.embedded import DepthSegmenter
from huepose.perception.view_detector import ViewDetector
from huepose.scenes.builtin import SyntheticScene
from huepose.support.progress import progress
from huepose.support.stages import StageClock, listening
from huepose.tracking import Tracker, TrackerConfig
from huepose.tracking.types import Correction

ESTIMATED, TRACKED = 12, 120
"""Numbers of measured frames."""

TRACKED_SIGMA = np.repeat([0.002, 0.01], 3)
"""Standard deviation of the priors of tracked objects, metres and radians: about that of a tracker."""

AT_ONCE = 2
"""Objects in one request of a running pipeline, by default (reinit.objects_per_tick)."""


@dataclass(frozen=True)
class StageTime:
    """Milliseconds of one stage: percentiles over repetitions. CPU time is that of the threads it ran in.

    first_wall_ms: of the first run in this process, which is not among the repetitions; allocated_mib: peak
    memory that one repetition allocates, without that of compiled kernels. Both None if not measured.
    """

    name: str
    wall_ms_p50: float
    wall_ms_p95: float
    wall_ms_p99: float
    cpu_ms_p50: float
    cpu_ms_p99: float
    first_wall_ms: float | None = None
    allocated_mib: float | None = None

    @staticmethod
    def of(
        name: str,
        spans: Sequence[tuple[float, float]],
        first_s: float | None = None,
        allocated_mib: float | None = None,
    ) -> StageTime:
        """spans: (wall, cpu) seconds, one for each repetition; first_s: wall seconds of the first run."""
        wall, cpu = 1000.0 * np.array(spans, dtype=np.float64).reshape(-1, 2).T
        p50, p95, p99 = np.percentile(wall, [50, 95, 99])
        cpu_p50, cpu_p99 = np.percentile(cpu, [50, 99])
        first_ms = None if first_s is None else 1000.0 * first_s
        times = float(p50), float(p95), float(p99), float(cpu_p50), float(cpu_p99)
        return StageTime(name, *times, first_ms, allocated_mib)


def bench_estimate(
    scene: SyntheticScene, models: Mapping[str, ReferenceModel], config: EstimatorConfig
) -> list[StageTime]:
    """All objects of the scene in disturbed true boxes, frame by frame: `estimate` as a whole on two threads,
    then each of its stages on one, summed over the objects of a frame. `estimate tracked`: with priors near
    the true poses instead of boxes, in a frame that is not searched in full."""
    estimator = Estimator(models, replace(config, threads=2))
    alone = Estimator(models, replace(config, threads=1))
    rows: dict[str, list[tuple[float, float]]] = {"estimate": [], "estimate tracked": []}
    first_s = allocated = 0.0
    rng, in_part = np.random.default_rng(0), _not_in_full(config.look_anew_every)
    steps = np.linspace(0, len(scene), ESTIMATED + 1, endpoint=False).astype(int)
    for k, i in enumerate(progress(steps, f"estimating ({config.method})")):
        frame, queries, tracked = scene.frame(int(i)), [], []
        for truth in scene.truths(int(i)):
            if truth.box_visib is not None and truth.object is not None:
                if truth.T_cam_obj is not None:
                    near = PosePrior(se3.perturb(truth.T_cam_obj, rng.normal(0.0, TRACKED_SIGMA)))
                    tracked.append(ObjectQuery(truth.object, prior=near))
                where = ("bench", int(i), truth.instance)
                box = disturbed(truth.box_visib, "perturbed", 0, *where, frame.camera)
                queries.append(ObjectQuery(truth.object, box))
        whole = _timed(partial(estimator.estimate, frame, queries))
        with listening() as clock:
            alone.estimate(frame, queries)
        if k == 0:  # prepares the models
            first_s = whole[0]
            continue
        rows["estimate"].append(whole)
        followed = partial(estimator.estimate, replace(frame, frame_id=in_part), tracked)
        rows["estimate tracked"].append(_timed(followed))
        _collect(rows, "estimate", clock)
        if k == 1:
            allocated = _allocated_mib(partial(estimator.estimate, frame, queries))
    return _stages(rows, {"estimate": (first_s, allocated)})


def _not_in_full(every: int) -> int:
    """The number of a frame that is not searched in full; 0 if there are no such frames."""
    return next((k for k in range(every * every) if not looks_in_full(k, every)), 0)


def bench_track(
    scene: SyntheticScene, models: Mapping[str, ReferenceModel], config: TrackerConfig
) -> list[StageTime]:
    """All objects of the scene, started from their true poses and tracked through its frames: each step as a
    whole, and its stages."""
    tracker = Tracker(models, config)
    tracker.warm_up()
    first = scene.frame(0)
    for truth in scene.truths(0):
        if truth.object is not None and truth.T_cam_obj is not None:
            tracker.correct(Correction.first(truth.object, truth.T_cam_obj, first, 1.0))
    rows: dict[str, list[tuple[float, float]]] = {"track": []}
    first_s = 0.0
    for i in progress(range(TRACKED), "tracking"):
        frame = scene.frame(i)
        with listening() as clock:
            whole = _timed(partial(tracker.step, frame))
        if i == 0:
            first_s = whole[0]
        if i < 3:
            continue
        rows["track"].append(whole)
        _collect(rows, "track", clock)
    allocated = _allocated_mib(partial(tracker.step, scene.frame(TRACKED)))
    return _stages(rows, {"track": (first_s, allocated)})


def bench_perception(
    scene: SyntheticScene,
    models: Mapping[str, ReferenceModel],
    config: DetectorConfig | None = None,
    frames: int = 12,
) -> list[StageTime]:
    """On two threads, as in a pipeline. `detect`: all objects of the scene in one request, one of them
    searched for in the whole image if the first step does not find it; its stages. `detect two`: two
    objects. `detect missing`: one that was removed from the frame; `detect still missing`: the same frame
    again with other noise, as from a static camera. `segment`: masks in the boxes of all objects."""
    config = replace(config or DetectorConfig(), threads=2)
    detector, segmenter = ViewDetector(models, config), DepthSegmenter()
    remembering = ViewDetector(models, replace(config, remembering=True))
    detector.warm_up()
    names = list(models)
    rows: dict[str, list[tuple[float, float]]] = {}
    first_s = allocated = 0.0
    for k, i in enumerate(progress(np.linspace(0, len(scene), frames + 1, endpoint=False), "detecting")):
        frame, truths = scene.frame(int(i)), scene.truths(int(i))
        chosen = names[k % len(names)]
        two = [chosen, names[(k + 1) % len(names)]][:AT_ONCE]
        without = _taken_out(frame, next((t for t in truths if t.object == chosen), None))
        remembering.detect(without, [chosen])
        boxes = [(t.box_visib, models[t.object]) for t in truths if t.box_visib and t.object]
        with listening() as clock:
            whole = _timed(partial(detector.detect, frame, names, (chosen,)))
        spans = {f"detect/{name}": total for name, total in clock.totals().items()}
        spans |= {
            "detect": whole,
            "detect two": _timed(partial(detector.detect, frame, two, two[:1])),
            "detect missing": _timed(partial(detector.detect, without, [chosen])),
            "detect still missing": _timed(partial(remembering.detect, _again(without, k), [chosen])),
            "segment": _timed(partial(_segmented, segmenter, frame, boxes)),
        }
        if k == 0:  # prepares the models
            first_s = whole[0]
            continue
        for name, span in spans.items():
            rows.setdefault(name, []).append(span)
        if k == 1:
            allocated = _allocated_mib(partial(detector.detect, frame, names, (chosen,)))
    wholes = ["detect two", "detect missing", "detect still missing", "segment"]
    order = ["detect", *(name for name in rows if "/" in name), *wholes]
    return _stages({name: rows[name] for name in order}, {"detect": (first_s, allocated)})


def _again(frame: RgbdFrame, seed: int) -> RgbdFrame:
    """The same view with more noise: 2 of 255 levels of colour; 2 mm times the square of depth in metres."""
    rng = np.random.default_rng(seed)
    color = np.clip(np.rint(frame.color + rng.normal(0.0, 2.0, frame.color.shape)), 0, 255).astype(np.uint8)
    depth = frame.depth + rng.normal(0.0, 0.002, frame.depth.shape).astype(np.float32) * frame.depth**2
    return replace(frame, color=color, depth=depth)


def _taken_out(frame: RgbdFrame, truth: GroundTruth | None) -> RgbdFrame:
    """The frame without depth where an object is visible, so that it cannot be found there."""
    mask = None if truth is None else truth.mask()
    return frame if mask is None else frame.without(mask)


def _segmented(
    segmenter: DepthSegmenter, frame: RgbdFrame, boxes: Sequence[tuple[Box, ReferenceModel]]
) -> None:
    for box, model in boxes:
        segmenter.segment(frame, box, model.diameter_m)


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu


def _allocated_mib(work: Callable[[], object]) -> float:
    """Peak memory that Python and numpy allocate while `work` runs."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def _stages(
    rows: Mapping[str, Sequence[tuple[float, float]]], wholes: Mapping[str, tuple[float, float]]
) -> list[StageTime]:
    """One StageTime for each row. wholes: (first wall s, allocated MiB) of rows that have them."""
    return [StageTime.of(name, spans, *wholes.get(name, ())) for name, spans in rows.items()]


def _collect(rows: dict[str, list[tuple[float, float]]], prefix: str, clock: StageClock) -> None:
    for name, total in clock.totals().items():
        rows.setdefault(f"{prefix}/{name}", []).append(total)
