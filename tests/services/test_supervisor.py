"""When a worker counts as hung or late. test_processes tests that it is then ended and restarted."""

import errno
import io
import os
import signal
import subprocess
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest

from huepose_services.runtime.config import Config, RestartConfig
from huepose_services.runtime.log import Log
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
def test_a_silent_or_late_worker_has_a_fault(supervisor, worker, silent_s, runs, fault):
    found = supervisor._fault(Running(worker, silent_s, runs))
    assert found is None if fault is None else found.startswith(fault)


def test_a_worker_that_waits_for_the_compiler_does_not_count_as_hung(supervisor):
    assert supervisor._fault(Running("tracker", 8.0, compiling=True)) is None
    assert supervisor._fault(Running("tracker", 8.0)) is not None
    fault = supervisor._fault(Running("tracker", 11.0, compiling=True))
    assert fault == "has compiled for more than 10 s"


def test_after_each_fault_the_allowed_silence_doubles(supervisor):
    assert supervisor._fault(Running("tracker", 3.0)) is not None
    assert supervisor._fault(Running("tracker", 3.0)) is None
    assert supervisor._fault(Running("tracker", 5.0)) is not None
    assert supervisor._fault(Running("tracker", 7.0)) is None
    assert supervisor._fault(Running("reinit", 3.0)) is not None, "each worker by itself"


def test_a_time_in_which_the_machine_was_blocked_does_not_count(supervisor):
    child = Running("tracker", 0.5)
    supervisor._children["tracker"] = child
    supervisor._polled = time.monotonic() - 30.0
    child.heard -= 30.0
    supervisor._forgive_standstill(0.1)
    assert supervisor._fault(child) is None


class Waited:
    """A process that waited for a processor for so long since the last call."""

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
    assert supervisor._fault(child) is None, "five of nine seconds count; six are allowed"
    child._starved = Waited(0.0)
    child.heard -= 2.0
    child.forgive_starving()
    assert supervisor._fault(child) is not None
    child._starved = Waited(60.0)
    child.forgive_starving()
    assert child.heard <= time.monotonic(), "the time is not credited for later"


def test_the_log_of_a_worker_is_read_even_if_it_cannot_be_written():
    """If nobody reads the pipe any more, the worker that writes into it blocks."""

    class FullDisk(io.StringIO):
        def write(self, text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    lines = iter(
        [b"12:00:00.000 info  camera    ready\n", b"of a library\n", b"12:00:01.000 info  the last\n"]
    )
    child = object.__new__(Child)
    child._log_name, child._out = "camera", FullDisk()
    child.process = SimpleNamespace(stdout=lines)
    child._copy_log()
    assert next(lines, None) is None


def test_the_reason_why_a_worker_has_ended_is_logged_as_its_error(monkeypatch):
    monkeypatch.delenv("HUEPOSE_LOG", raising=False)
    child = object.__new__(Child)
    child._log_name, child._out = "camera", io.StringIO()
    child.process = SimpleNamespace(stdout=[b"of a library\n", b"huepose run: desk/rgb: found no folder.\n"])
    child._copy_log()
    said = [line.split(maxsplit=1)[1] for line in child._out.getvalue().splitlines()]
    assert said == ["warn  camera    of a library", "error camera    desk/rgb: found no folder."]


def test_lines_of_workers_have_their_levels_in_the_journal(monkeypatch, capsys):
    monkeypatch.delenv("HUEPOSE_LOG", raising=False)
    Log("left/estimator").error("it broke\n  in a line")
    Log("camera").say("ready")
    monkeypatch.setattr("huepose_services.runtime.log._to_journal", lambda: True)
    child = object.__new__(Child)
    child._log_name, child._out = "camera", io.StringIO()
    child.process = SimpleNamespace(stdout=capsys.readouterr().err.encode().splitlines(keepends=True))
    child._copy_log()
    said = ["<3>left/estimator: it broke", "<3>left/estimator:   in a line", "<6>camera: ready"]
    assert child._out.getvalue().splitlines() == said


@pytest.fixture
def alone():
    """A supervisor of one worker, and its log."""
    out = io.StringIO()
    config = Config(workers=("tracker",), restarts=LIMITS)
    return Supervisor(config, Path("pipeline.yaml"), out), out


def test_a_worker_that_cannot_be_started_now_is_started_later(alone, monkeypatch):
    supervisor, out = alone

    def no_room(*_, **__):
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr(subprocess, "Popen", no_room)
    before = os.listdir("/proc/self/fd")
    supervisor.start()
    assert os.listdir("/proc/self/fd") == before
    said = f"tracker could not be started ([Errno {errno.ENOMEM}] Cannot allocate memory): starting it again"
    assert f"{said} in 0.25 s" in out.getvalue()
    time.sleep(0.26)
    supervisor.poll(0.0)
    assert f"{said} in 0.5 s" in out.getvalue()
    assert supervisor.exit_code is None


def test_a_worker_whose_log_cannot_be_read_is_ended(alone, monkeypatch):
    supervisor, out = alone
    started, popen = [], subprocess.Popen

    def sleeper(_, **settings):
        started.append(popen(["sleep", "60"], **settings))
        return started[-1]

    def no_room(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(subprocess, "Popen", sleeper)
    monkeypatch.setattr(threading.Thread, "start", no_room)
    supervisor.start()
    assert started[0].returncode is not None
    assert "tracker could not be started (can't start new thread)" in out.getvalue()
    started[0].stdout.close()


class Held:
    """A process that the kernel does not end when it is killed, until `code` is set."""

    pid, code, kills = 2**22 + 1, None, 0

    def poll(self):
        return self.code

    def wait(self, timeout=None):
        assert timeout is not None, "it would wait for ever"
        raise subprocess.TimeoutExpired("worker", timeout)

    def send_signal(self, number):
        pass

    def kill(self):
        self.kills += 1


def ended(supervisor, worker, code):
    """One poll of a supervisor whose worker has just ended with this code."""
    child = object.__new__(Child)
    child.worker, child.process, child.pipe, child._starved = worker, Held(), None, None
    child.ready, child.runs, child.compiling, child.killed = True, True, False, False
    child.started = child.heard = time.monotonic()
    child.process.code = code
    child._reader = threading.Thread()
    child._reader.start()
    supervisor._children[worker] = child
    supervisor.poll(0.0)


def test_a_file_that_was_overwritten_in_place_is_named_as_the_cause_of_a_workers_end(alone):
    supervisor, out = alone
    ended(supervisor, "tracker", -signal.SIGBUS)
    assert (
        "killed by signal 7 (SIGBUS: a file that it uses was overwritten in place, such as" in out.getvalue()
    )
    ended(supervisor, "tracker", -signal.SIGKILL)
    assert "tracker killed by signal 9: starting it again" in out.getvalue()


def test_a_worker_that_was_given_up_is_not_reported_to_read_the_file_again(tmp_path):
    out, path = io.StringIO(), tmp_path / "pipeline.yaml"
    path.write_text("{}")
    config = Config(workers=("camera", "tracker"), restarts=RestartConfig(limit=0))
    supervisor = Supervisor(config, path, out)
    supervisor._records["camera"].restart_at = time.monotonic() + 60.0
    ended(supervisor, "tracker", -signal.SIGKILL)
    assert "given up" in out.getvalue()
    assert "Mend what it said last, then start the pipeline again" in out.getvalue()
    supervisor.reload()
    assert "all workers but tracker, given up, read the configuration again" in out.getvalue()


def test_a_killed_worker_that_does_not_end_is_restarted_when_it_has_ended(alone):
    supervisor, out = alone
    child = object.__new__(Child)
    child.worker, child.process, child.pipe, child._starved = "tracker", Held(), None, None
    child.ready, child.runs, child.compiling, child.killed = True, True, False, False
    child.started = child.heard = time.monotonic() - 9.0
    child._reader = threading.Thread()
    child._reader.start()
    supervisor._children["tracker"] = child
    for _ in range(3):
        supervisor.poll(0.0)
    assert (
        child.process.kills
        == out.getvalue().count("does not end yet: the computer is busy, or a device")
        == 1
    )
    assert supervisor.not_ready == {"tracker"}
    assert supervisor._records["tracker"].restart_at is None
    child.process.code = -9
    supervisor.poll(0.0)
    assert supervisor._records["tracker"].restart_at is not None
    assert "tracker was killed: starting it again in 0.25 s" in out.getvalue()
