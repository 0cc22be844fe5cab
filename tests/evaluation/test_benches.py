import pytest

from huepose.evaluation.benches import StageTime


def test_percentiles_are_in_milliseconds():
    spans = [(0.001 * k, 0.0005 * k) for k in range(1, 102)]
    time = StageTime.of("masks", spans)
    assert time.wall_ms_p50 == pytest.approx(51)
    assert time.wall_ms_p95 == pytest.approx(96)
    assert time.wall_ms_p99 == pytest.approx(100)
    assert time.cpu_ms_p50 == pytest.approx(25.5)
    assert time.cpu_ms_p99 == pytest.approx(50)
