import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from huepose.believe.quality import MOST_MARGIN
from huepose.evaluation.calibration import FALSE_WEIGHT, by_chance, read_judged, worth
from huepose.support.errors import InputError
from tests.evaluation.judged import PLAIN, judged


def test_coverage_counts_instances_without_a_pose() -> None:
    few = replace(judged([PLAIN] * 4, np.array([0, 0, -1, 0])), missed=4)
    known = worth(np.array([0.9, 0.95, 0.97, 0.2]), few, 0.9)
    assert (known.poses, known.right) == (8, 3)
    assert known.coverage == pytest.approx(3 / 8)
    assert known.found == pytest.approx(0.5)
    assert known.precision == pytest.approx(2 / 3)


def test_the_calibration_error_by_chance_depends_on_the_number_of_instances() -> None:
    """1000 poses with quality 0.5. In bins of 100, the mean error is that of the mean of 100 coin tosses,
    0.04. If each instance is estimated five times, it is that of 20 coin tosses."""
    quality = np.full(1000, 0.5)
    alone, _ = by_chance(quality, range(1000)) or (0.0, 0.0)
    assert alone == pytest.approx(0.5 * np.sqrt(2 / np.pi / 100), rel=0.05)
    often, high = by_chance(quality, [k // 5 for k in range(1000)]) or (0.0, 0.0)
    assert often == pytest.approx(0.5 * np.sqrt(2 / np.pi / 20), rel=0.1)
    assert often < high < 2.0 * often
    assert by_chance(np.zeros(0), []) is None


def test_true_quality_errs_by_chance_only_and_overstated_quality_by_the_excess() -> None:
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.3, 1.0, 3000)
    true, overstated = (
        judged([PLAIN] * 3000, -(rng.random(3000) >= stated - more).astype(int)) for more in (0.0, 0.2)
    )
    shown = worth(stated, true, 0.9)
    assert shown.ece is not None
    assert shown.chance is not None
    assert shown.ece < 1.5 * shown.chance[1]
    assert worth(stated, overstated, 0.9).ece == pytest.approx(0.2, abs=0.02)


def test_the_margin_is_the_gap_to_the_best_other_answer() -> None:
    assert replace(PLAIN, gaps=()).margin == MOST_MARGIN
    assert replace(PLAIN, gaps=(0.05, 0.2)).margin == 0.05
    assert replace(PLAIN, gaps=(1.0,)).margin == MOST_MARGIN


def test_results_are_read_with_the_index_of_the_right_answer(tmp_path: Path) -> None:
    row = {
        "scene": "a", "image": 1, "found": True, "right": False, "quality": 0.6, "terms": asdict(PLAIN),
        "adds_m": 0.01, "diameter_m": 0.2,
        "alternatives": [{"probability": 0.3, "right": True}, {"probability": 0.1, "right": True}],
    }  # fmt: skip
    path = tmp_path / "result.json"
    path.write_text(
        json.dumps({"rows": [row, {**row, "right": True}, {**row, "found": False}], "false": [row]})
    )
    shown = read_judged(path)
    assert shown.which.tolist() == [1, 0, -1]
    assert shown.placed.tolist() == [True, True, False]
    assert shown.weights.tolist() == [1.0, 1.0, FALSE_WEIGHT]
    assert shown.missed == 1
    assert shown.terms[0] == PLAIN
    old = {key: value for key, value in asdict(PLAIN).items() if key != "missing"}
    path.write_text(json.dumps({"rows": [{**row, "terms": old}]}))
    with pytest.raises(InputError, match="Make it again"):
        read_judged(path)
