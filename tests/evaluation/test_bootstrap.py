import numpy as np
import pytest

from huepose.evaluation.bootstrap import frame_intervals


def test_the_interval_of_independent_frames_is_that_of_the_mean() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(50.0, 20.0, 400)
    low, high = frame_intervals({"x": values}, list(range(400)))["x"]
    assert (low + high) / 2 == pytest.approx(values.mean(), abs=0.3)
    assert high - low == pytest.approx(2 * 1.96 * 20.0 / 20.0, rel=0.1)


def test_instances_of_one_frame_count_as_one_draw() -> None:
    values = np.repeat([0.0, 100.0] * 20, 10)
    alone = frame_intervals({"x": values}, list(range(400)))["x"]
    together = frame_intervals({"x": values}, [k // 10 for k in range(400)])["x"]
    assert together[1] - together[0] == pytest.approx(np.sqrt(10) * (alone[1] - alone[0]), rel=0.15)


def test_nothing_gives_nothing() -> None:
    assert frame_intervals({"x": np.zeros(0)}, []) == {}
