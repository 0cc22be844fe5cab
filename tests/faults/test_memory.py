"""Growing memory is distinguished from memory that is taken once."""

from __future__ import annotations

import msgspec
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import HealthMessage
from huepose_services.chaos.memory import growth

HEALTH = example(HealthMessage)


def _healths(memory_mib, seconds, pid=1):
    """A worker's health messages, one a second."""
    return [
        (float(at), msgspec.structs.replace(HEALTH, worker="estimator", pid=pid, memory_mib=memory_mib(at)))
        for at in range(seconds)
    ]


def _rate(healths):
    return growth(healths, 0.0, float(len(healths)))["estimator"].mib_per_hour


@pytest.mark.parametrize("at_s", [100, 200, 330, 400, 500])
def test_a_step_is_no_growth(at_s):
    found = growth(_healths(lambda at: 400.0 + 0.5 * (at % 2) + 90.0 * (at > at_s), 600), 0.0, 600.0)
    assert found["estimator"].mib_per_hour == pytest.approx(0.0, abs=1.0)
    assert found["estimator"].last_mib - found["estimator"].first_mib == pytest.approx(90.0, abs=1.0)


def test_memory_that_is_taken_repeatedly_is_growth():
    assert _rate(_healths(lambda at: 400.0 + at / 36.0, 600)) == pytest.approx(100.0, rel=0.01)
    assert _rate(_healths(lambda at: 400.0 + 2.0 * (at // 72), 900)) == pytest.approx(100.0, rel=0.1)


def test_a_short_time_gives_no_rate_per_hour():
    healths = _healths(lambda at: 400.0 + at, 200)
    assert _rate(healths) is None
    assert str(growth(healths, 0.0, 200.0)["estimator"]) == "460 to 599 MiB in 2.3 minutes"


def test_a_restart_is_no_growth():
    healths = _healths(lambda at: 200.0, 500) + [
        (500.0 + at, m) for at, m in _healths(lambda at: 600.0, 100, pid=2)
    ]
    assert _rate(healths) == pytest.approx(0.0)
