"""Answers that are kept in pieces: the figures are those of one run, and options are not mixed."""

import sys
from pathlib import Path

import numpy as np
import pytest

from huepose.evaluation.estimate_rows import EstimateResult, EstimateRow
from huepose.evaluation.targets import PoseError
from huepose.support.errors import InputError

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from estimate_record import Record


def _row(scene: str, image: int, add_m: float) -> EstimateRow:
    T = None if np.isinf(add_m) else np.eye(4)
    error = PoseError(add_m, add_m / 2, add_m, add_m < 0.01)
    return EstimateRow(scene, image, 0, 5, 0.8, T, error, 0.1, 0.5, "LOST", 0.1, 0, None)


def test_figures_of_pieces_are_those_of_one_run(tmp_path: Path) -> None:
    rows = [_row("a", 1, 0.004), _row("a", 2, 0.03), _row("b", 1, np.inf), _row("b", 1, 0.002)]
    whole = EstimateResult(rows, [], 0, "perturbed", "auto", (0,)).summary()
    file = tmp_path / "answers.json"
    Record(file, {"seed": 0}).add("fgr", "auto", ("a", 1), rows[:1], [0.2])
    Record(file, {"seed": 0}).add("fgr", "auto", ("a", 2), rows[1:2], [0.4])
    Record(file, {"seed": 0}).add("fgr", "auto", ("b", 1), rows[2:], [0.0, 0.6])
    record = Record(file, {"seed": 0})
    images = [("a", 1), ("a", 2), ("b", 1)]
    assert all(record.has("fgr", "auto", image) for image in images)
    assert not record.has("fgr", "gt", ("a", 1))
    summary = record.summary("fgr", "auto", images, 0)
    assert summary is not None
    for name in ("recall_add", "recall_adds", "auc_add", "auc_adds", "interval95", "instances"):
        assert summary[name] == whole[name]
    assert summary["recall_add"] == 50.0
    assert summary["cpu_s_p50"] == pytest.approx(0.4)  # what found nothing is not counted
    assert record.summary("fgr", "auto", images[:1], 0)["recall_add"] == 100.0
    assert record.summary("ppf", "auto", images, 0) is None


def test_answers_of_other_options_are_not_mixed(tmp_path: Path) -> None:
    file = tmp_path / "answers.json"
    Record(file, {"seed": 0}).add("fgr", "auto", ("a", 1), [_row("a", 1, 0.004)], [0.2])
    with pytest.raises(InputError, match="Name another file"):
        Record(file, {"seed": 1})
    file.write_text("[1, 2")
    with pytest.raises(InputError, match="not a file of this benchmark"):
        Record(file, {"seed": 0})
