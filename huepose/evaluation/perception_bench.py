"""How long perception takes before the estimator: detector and segmenter on the built-in scene."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from huepose.datasets.types import GroundTruth
from huepose.evaluation.benches import StageTime
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.config import DetectorConfig
from huepose.perception.embedded import DepthSegmenter
from huepose.scenes.builtin import SyntheticScene
from huepose.support.progress import progress
from huepose.support.stages import listening

AT_ONCE = 2
"""Objects that a running pipeline asks for at once, by default (reinit.objects_per_tick)."""


def bench_perception(
    scene: SyntheticScene,
    models: Mapping[str, ReferenceModel],
    config: DetectorConfig | None = None,
    frames: int = 12,
) -> list[StageTime]:
    """`detect`: all objects of the scene asked for at once, as a running pipeline asks, one of them searched
    everywhere where a first look does not find it; its stages. `detect two`: two of them. `detect missing`:
    one that was taken out of the picture. `segment`: masks in the boxes of all."""
    detector, segmenter = ColorPairDetector(models, config), DepthSegmenter()
    detector.warm_up()
    names = list(models)
    rows: dict[str, list[tuple[float, float]]] = {}
    for k, i in enumerate(progress(np.linspace(0, len(scene), frames + 1, endpoint=False), "detecting")):
        frame, truths = scene.frame(int(i)), scene.truth(int(i))
        turn = names[k % len(names)]
        two = [turn, names[(k + 1) % len(names)]][:AT_ONCE]
        without = _taken_out(frame, next((t for t in truths if t.object == turn), None))
        boxes = [(t.box_visib, models[t.object]) for t in truths if t.box_visib and t.object]
        with listening() as clock:
            whole = _timed(partial(detector.detect, frame, names, (turn,)))
        spans = {f"detect/{name}": total for name, total in clock.totals().items()}
        spans |= {
            "detect": whole,
            "detect two": _timed(partial(detector.detect, frame, two, two[:1])),
            "detect missing": _timed(partial(detector.detect, without, [turn])),
            "segment": _timed(partial(_segmented, segmenter, frame, boxes)),
        }
        for name, span in spans.items() if k else ():  # the first compiles
            rows.setdefault(name, []).append(span)
    order = ["detect", *(name for name in rows if "/" in name), "detect two", "detect missing", "segment"]
    return [StageTime.of(name, rows[name]) for name in order]


def _taken_out(frame: RgbdFrame, truth: GroundTruth | None) -> RgbdFrame:
    """The frame without depth where an object is seen: nothing else looks like it there."""
    mask = None if truth is None else truth.mask()
    return frame if mask is None else replace(frame, depth=np.where(mask, np.float32(0.0), frame.depth))


def _segmented(
    segmenter: DepthSegmenter, frame: RgbdFrame, boxes: Sequence[tuple[Box, ReferenceModel]]
) -> None:
    for box, model in boxes:
        segmenter.segment(frame, box, model.diameter_m)


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - cpu
