"""The figures of a long run."""

from types import SimpleNamespace

from benchmarks.soak import _worker
from huepose_protos.examples import example
from huepose_protos.messages import HealthMessage


def test_a_worker_with_few_health_messages_or_none_does_not_cost_the_result() -> None:
    message = example(HealthMessage)
    pipeline = SimpleNamespace(health_log=[(5.0, message)])
    assert _worker(pipeline, message.worker, 0.0, 10.0, 1.0)["memory"] is None
    assert "no health message" in _worker(pipeline, "another", 0.0, 10.0, 1.0)["last_error"]
