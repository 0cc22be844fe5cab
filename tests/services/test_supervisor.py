"""When a worker is taken for hung or late. That it is then ended and started again: test_processes."""

import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from huepose_services.runtime.config import Config, RestartConfig
from huepose_services.runtime.supervisor import Child, Supervisor

LIMITS = RestartConfig(start_within_s=10.0, hung_after_s=2.0, window_s=60.0)


@dataclass
class Running:
    """A child that was last heard of, or started, some time ago."""

    worker: str
    silent_s: float
    runs: bool = True
    compiling: bool = False
    heard: float = field(init=False)
    started: float = field(init=False)

    def __post_init__(self):
        self.heard = self.started = time.monotonic() - self.silent_s


@pytest.fixture
def supervisor():
    return Supervisor(Config(restarts=LIMITS), Path("pipeline.yaml"))


@pytest.mark.parametrize(
    ("worker", "silent_s", "runs", "fault"),
    [
        ("tracker", 1.0, True, None),
        ("tracker", 3.0, True, "has given no sign of life for 3."),
        ("estimator", 3.0, True, None),
        ("estimator", 7.0, True, "has given no sign of life for 7."),
        ("camera", 8.0, False, None),
        ("camera", 11.0, False, "is not ready after 10 s"),
    ],
)
def test_silence_and_lateness(supervisor, worker, silent_s, runs, fault):
    found = supervisor._fault(Running(worker, silent_s, runs))
    assert found is None if fault is None else found.startswith(fault)


def test_who_waits_for_the_compiler_is_not_taken_for_hung(supervisor):
    assert supervisor._fault(Running("tracker", 8.0, compiling=True)) is None
    assert supervisor._fault(Running("tracker", 8.0)) is not None
    fault = supervisor._fault(Running("tracker", 11.0, compiling=True))
    assert fault == "has compiled for more than 10 s"


def test_each_time_the_patience_doubles(supervisor):
    assert supervisor._fault(Running("tracker", 3.0)) is not None
    assert supervisor._fault(Running("tracker", 3.0)) is None
    assert supervisor._fault(Running("tracker", 5.0)) is not None
    assert supervisor._fault(Running("tracker", 7.0)) is None
    assert supervisor._fault(Running("reinit", 3.0)) is not None, "each worker by itself"


def test_a_time_in_which_nothing_ran_does_not_count(supervisor):
    child = Running("tracker", 0.5)
    supervisor._children["tracker"] = child
    supervisor._polled = time.monotonic() - 30.0
    child.heard -= 30.0
    supervisor._forgive_standstill(0.1)
    assert supervisor._fault(child) is None


class Waited:
    """A process that waited for a processor for so long since it was last asked."""

    def __init__(self, seconds):
        self.seconds = seconds

    def since_last_s(self):
        return self.seconds


def test_a_time_in_which_others_had_the_processor_does_not_count(supervisor):
    child = object.__new__(Child)
    child.worker, child.runs, child.compiling = "estimator", True, False
    child.started = child.heard = time.monotonic() - 9.0
    child._starved = Waited(4.0)
    child.forgive_starving()
    assert supervisor._fault(child) is None, "five of nine seconds count, of six"
    child._starved = Waited(0.0)
    child.heard -= 2.0
    child.forgive_starving()
    assert supervisor._fault(child) is not None
    child._starved = Waited(60.0)
    child.forgive_starving()
    assert child.heard <= time.monotonic(), "no patience is saved up"
