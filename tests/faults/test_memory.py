"""Whether memory grows is told from what is taken once."""

from __future__ import annotations

import msgspec
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import HealthMessage
from huepose_services.chaos.memory import growth

SAID = example(HealthMessage)


def _said(memory_mib, seconds, pid=1):
    """What a worker says once a second."""
    return [
        (float(at), msgspec.structs.replace(SAID, worker="estimator", pid=pid, memory_mib=memory_mib(at)))
        for at in range(seconds)
    ]


def _rate(said):
    return growth(said, 0.0, float(len(said)))["estimator"].mib_per_hour


@pytest.mark.parametrize("at_s", [100, 200, 330, 400, 500])
def test_a_step_is_no_growth(at_s):
    found = growth(_said(lambda at: 400.0 + 0.5 * (at % 2) + 90.0 * (at > at_s), 600), 0.0, 600.0)
    assert found["estimator"].mib_per_hour == pytest.approx(0.0, abs=1.0)
    assert found["estimator"].last_mib - found["estimator"].first_mib == pytest.approx(90.0, abs=1.0)


def test_what_is_taken_again_and_again_is_growth():
    assert _rate(_said(lambda at: 400.0 + at / 36.0, 600)) == pytest.approx(100.0, rel=0.01)
    assert _rate(_said(lambda at: 400.0 + 2.0 * (at // 72), 900)) == pytest.approx(100.0, rel=0.1)


def test_a_short_life_says_nothing_of_an_hour():
    said = _said(lambda at: 400.0 + at, 200)
    assert _rate(said) is None
    assert str(growth(said, 0.0, 200.0)["estimator"]) == "460 to 599 MiB in 2.3 minutes"


def test_a_restart_is_no_growth():
    said = _said(lambda at: 200.0, 500) + [(500.0 + at, m) for at, m in _said(lambda at: 600.0, 100, pid=2)]
    assert _rate(said) == pytest.approx(0.0)
