"""Some faults of a running pipeline, for a short time; `huepose chaos` injects all, for longer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from huepose_services.chaos import system as chaos_system
from huepose_services.chaos.faults import FAULTS
from huepose_services.chaos.outcome import STEADY_OBJECTS, strike
from huepose_services.chaos.system import LivePipeline
from tests.services.conftest import runs, started_by, until

pytestmark = [pytest.mark.live, pytest.mark.pipeline, pytest.mark.timeout(900)]

# Faults of the camera, the bus, a worker and a subscriber. At 10 Hz, because a busy computer may be slow.
SLOW, SHORT_S = 3.0, 2.5
LONG = (21, 22)  # these need seconds: what is kept, and which of two cameras is used
SHORT = (
    "last image with new timestamps",
    "depth 3 images late",
    "depth all nan",
    "focal length 1.5 times too long",
    "empty masks, masks of another size",
    "frames twice and out of order",
    "corrections older than what is kept",
    "a second camera under one key",
    "a reader that takes 100 ms each",
    "reinit killed",
    "tracker killed",
)
FAULT = {fault.name: fault for fault in FAULTS}


@pytest.fixture(scope="module")
def system():
    with LivePipeline(live=True, slow=SLOW) as one:
        assert one.wait_until_steady(STEADY_OBJECTS, 700.0), one.log()[-3000:]
        yield one


@pytest.mark.parametrize("name", SHORT)
def test_what_must_hold_holds(system, name):
    fault = FAULT[name]
    if fault.number not in LONG:
        fault = replace(fault, seconds=min(fault.seconds, SHORT_S))
    # At its end `strike` saw all well for two seconds, as the fixture did.
    outcome = strike(system, fault, 120.0, steady_s=0.0)
    assert outcome.broken == [], (outcome, system.log()[-2000:])
    assert outcome.tracking_poses > 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_pipeline_ends_with_the_chaos_that_started_it(tmp_path, number):
    command = [sys.executable, "-m", "huepose_services.cli.main", "chaos", "--only", "0"]
    chaos = subprocess.Popen(command, env={**os.environ, "TMPDIR": str(tmp_path)}, stderr=subprocess.DEVNULL)
    try:
        until(lambda: any(map(started_by, started_by(chaos.pid))), 700.0)
        (up,) = started_by(chaos.pid)
        workers = started_by(up)
        chaos.send_signal(number)
        chaos.wait(15.0)
    finally:
        chaos.kill()
    until(lambda: not any(map(runs, (up, *workers))), 10.0)
    if number == signal.SIGTERM:
        assert list(tmp_path.glob("huepose-live-*")) == []


def test_a_pipeline_whose_messages_cannot_be_read_is_ended(monkeypatch):
    monkeypatch.setattr(chaos_system, "Reader", lambda *_: 1 // 0)
    system = LivePipeline()
    with pytest.raises(ZeroDivisionError), system:
        pass
    assert not system.path.parent.exists()
    children = [Path(f"/proc/{pid}/cmdline").read_text() for pid in started_by(os.getpid())]
    assert not any(str(system.path) in command for command in children)
