"""Percentiles, and the perception bench: all objects, two objects, an absent one, masks."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.datasets.types import GroundTruth
from huepose.estimation import EstimatorConfig
from huepose.evaluation.benches import StageTime, _taken_out, bench_estimate, bench_perception
from huepose.geometry import Box
from huepose.rendering.render import render_depth


class Still:
    """A scene with a single image."""

    def __init__(self, frame, truth) -> None:
        self._frame, self._truth = frame, truth

    def __len__(self) -> int:
        return 1

    def frame(self, i):
        return self._frame

    def truths(self, i):
        return (self._truth,)


def test_every_stage_is_measured_and_the_absent_object_is_not_found(tea_box, box_frame, standing) -> None:
    mask = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    truth = GroundTruth(0, standing, object="tea_box", box_visib=Box.of_mask(mask), mask_loader=lambda: mask)
    stages = {s.name: s for s in bench_perception(Still(box_frame, truth), {"tea_box": tea_box}, frames=2)}
    assert {
        "detect",
        "detect/clear view",
        "detect/presence",
        "detect two",
        "detect missing",
        "detect still missing",
        "segment",
    } <= set(stages)
    assert all(s.cpu_ms_p50 > 0.0 for s in stages.values())
    out = _taken_out(box_frame, truth)
    assert not out.depth[mask].any()
    assert np.array_equal(out.depth[~mask], box_frame.depth[~mask])


def test_tracked_objects_are_estimated_without_a_search(tea_box, box_frame, standing) -> None:
    mask = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    truth = GroundTruth(0, standing, object="tea_box", box_visib=Box.of_mask(mask), mask_loader=lambda: mask)
    timed = bench_estimate(Still(box_frame, truth), {"tea_box": tea_box}, EstimatorConfig())
    stages = {stage.name: stage for stage in timed}
    assert {"estimate", "estimate tracked", "estimate/retrieval", "estimate/answer"} <= set(stages)
    assert 0.0 < stages["estimate tracked"].cpu_ms_p50 < stages["estimate"].cpu_ms_p50


def test_percentiles_are_in_milliseconds():
    spans = [(0.001 * k, 0.0005 * k) for k in range(1, 102)]
    time = StageTime.of("masks", spans)
    assert time.wall_ms_p50 == pytest.approx(51)
    assert time.wall_ms_p95 == pytest.approx(96)
    assert time.wall_ms_p99 == pytest.approx(100)
    assert time.cpu_ms_p50 == pytest.approx(25.5)
    assert time.cpu_ms_p99 == pytest.approx(50)
