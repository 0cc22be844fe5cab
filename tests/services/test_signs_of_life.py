"""What a worker reports to the process that started it: heartbeats, systemd's datagrams, the log."""

import errno
import io
import json
import os
import socket
import sys
import threading
import time
import weakref
from types import SimpleNamespace

import numba
import pytest
from numba.core import event

from huepose_protos import decode, encode
from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader, HealthMessage
from huepose_services.cli.status import as_text
from huepose_services.runtime import log as log_module
from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.compiling import LateCompiling
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log, StateChanges, is_log_line
from huepose_services.runtime.pulse import Pulse, notify, watchdog_s
from huepose_services.runtime.running import Pipeline
from huepose_services.watch import View


@numba.njit
def inner(x):
    return x + 1


@numba.njit
def kernel(x):
    return 2 * inner(x)


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """A socket like that of systemd."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(tmp_path / "notify"))
        end.settimeout(1.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield end


def test_a_rate_counts_from_the_first_work_not_from_the_start(monkeypatch):
    now = [0]
    monkeypatch.setattr("huepose_services.runtime.health.now_ns", lambda: now[0])
    health, frame = Health("tracker"), example(FrameHeader)
    assert health.message().rate_hz == 0.0
    now[0] = 4 * SECOND  # of loading
    for _ in range(60):
        health.worked_on(now[0], frame)
        now[0] += SECOND // 30
    assert health.message().rate_hz == pytest.approx(30.0, abs=0.5)


def test_systemd_is_notified_of_readiness_and_of_work(manager, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert watchdog_s() == 2.0
    pulse = Pulse()
    pulse.running()
    assert manager.recv(1000) == b"READY=1"
    pulse.ready()
    assert manager.recv(1000) == b"STATUS=ready"
    for _ in range(100):
        pulse.beat()
    assert manager.recv(1000) == b"WATCHDOG=1"
    manager.setblocking(False)
    with pytest.raises(BlockingIOError):
        manager.recv(1000)  # at most five heartbeats are sent a second


def test_a_watchdog_of_another_process_is_ignored(monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert watchdog_s() is None


@pytest.mark.parametrize("address", ["", "relative", "/nonexistent/socket", "@nobody-listens-here"])
def test_a_socket_without_a_listener_is_no_error(monkeypatch, address):
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    assert notify("READY=1") is False


def test_the_supervisor_gets_heartbeats_through_a_pipe(monkeypatch):
    read_end, write_end = os.pipe()
    monkeypatch.setenv("HUEPOSE_READY_FD", str(write_end))
    pulse = Pulse()
    pulse.ready()
    pulse.beat()
    assert os.read(read_end, 100) == b"ready\n."
    os.close(read_end)
    pulse.ready()  # without the supervisor this is no error
    os.close(write_end)


def test_a_kernel_that_is_compiled_late_is_reported_while_it_is_compiled(monkeypatch, manager):
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    read_end, write_end = os.pipe()
    monkeypatch.setenv("HUEPOSE_READY_FD", str(write_end))
    pulse, health = Pulse(), Health("estimator")
    listener = LateCompiling(pulse, health, Log("estimator"))
    with event.install_listener("numba:compile", listener):
        assert kernel(3) == 8
        assert kernel(4) == 10
    assert os.read(read_end, 100) == b"c."
    assert manager.recv(100) == b"WATCHDOG_USEC=300000000"
    assert manager.recv(100) == b"WATCHDOG_USEC=2000000"
    assert health.counters == {"kernels_compiled_late": 1}
    for end in (read_end, write_end):
        os.close(end)


def test_every_line_of_the_log_has_time_level_and_worker(capsys):
    Log("tracker").warn("one\ntwo")
    lines = capsys.readouterr().err.splitlines()
    assert [line[13:] for line in lines] == ["warn  tracker   one", "warn  tracker   two"]
    assert all(map(is_log_line, lines))
    assert not is_log_line("[WARN] some library")


def test_the_log_as_json(capsys, monkeypatch):
    monkeypatch.setenv("HUEPOSE_LOG", "json")
    Log("tracker").error("it broke")
    line = capsys.readouterr().err
    assert is_log_line(line)
    got = json.loads(line)
    assert got.pop("time") == pytest.approx(time.time(), abs=5.0)
    assert got == {"level": "error", "worker": "tracker", "text": "it broke"}


@pytest.fixture
def log_clock(monkeypatch):
    """The log's time in seconds, in a list: a test sets it."""
    at = [100.0]
    monkeypatch.setattr(log_module, "time", SimpleNamespace(**vars(time) | {"monotonic": lambda: at[0]}))
    return at


def test_repeats_are_held_back_and_counted(capsys, log_clock):
    log = Log("tracker")
    for _ in range(5):
        log.seldom("kind", "again")
    log_clock[0] += 1.0
    log.seldom("kind", "again")
    assert capsys.readouterr().err.splitlines()[-1].endswith("again (4 more in 1 s)")


def test_a_change_of_state_gives_one_line_and_a_flicker_none(capsys, log_clock):
    changes = StateChanges(Log("tracker"), every_s=0.1, moment_s=0.05)

    def stays(state, seconds):
        for _ in range(round(seconds / 0.002)):
            changes.note("mug/0", state, "quality 0.90")
            changes.flush()
            log_clock[0] += 0.002

    stays("TRACKING", 0.1)
    changes.note("mug/0", "SUSPECT")  # for one frame
    stays("TRACKING", 0.1)
    stays("LOST", 0.2)
    lines = [line[29:] for line in capsys.readouterr().err.splitlines()]
    assert lines == ["mug/0 TRACKING (quality 0.90)", "mug/0 TRACKING > LOST (quality 0.90)"]


def test_too_much_locked_memory_is_a_warning():
    health = Health("tracker")
    assert health.message().warnings == []
    health.much_locked_mib = -1.0
    health.message()
    assert len(health.message().warnings) == 1
    assert "restart this worker" in health.message().warnings[0]


def test_health_counts_errors_and_keeps_the_last_one():
    health = Health("tracker")
    health.failed("first")
    health.failed("x" * 5000)
    message = health.message()
    assert (message.errors, len(message.last_error)) == (2, 500)
    assert message.memory_mib > 10.0


def test_health_and_status_say_how_often_a_worker_was_restarted(monkeypatch):
    monkeypatch.setenv("HUEPOSE_RESTARTS", "3")
    message = Health("tracker").message()
    assert message.restarts == 3
    pipeline = Pipeline(base_port=18200, workers=("tracker",))
    view = View(pipeline, True, {"tracker": message}, frozenset(), (), [], {})
    head, row = as_text(view).splitlines()[1:3]
    assert head.split()[-1] == "restarts"
    assert row.split()[-1] == "3"


def test_text_that_is_no_utf8_is_sent_escaped(manager):
    """As the name of an old file, in an error."""
    health, text = Health("camera"), "no such file: caf\udce9.png"
    health.failed(text)
    health.warn_while("file", text)
    health.picture = text
    message = decode(encode(health.message()), HealthMessage)
    written = r"no such file: caf\udce9.png"
    assert (message.last_error, message.warnings, message.picture) == (written, [written], written)
    assert notify(f"STATUS={text}")
    assert manager.recv(100) == f"STATUS={written}".encode()


class FullDisk(io.StringIO):
    def write(self, text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_log_that_cannot_be_written_raises_no_error(monkeypatch):
    monkeypatch.setattr("huepose_services.runtime.log._FIRST_S", 0.01)
    log = Log("tracker", FullDisk())
    log.error("it broke")
    for _ in range(2):
        log.seldom("kind", "again")
    time.sleep(0.02)
    log.flush()


class Line(str):
    """A string that can have weak references."""

    __slots__ = ("__weakref__",)


def test_lines_that_all_differ_are_forgotten():
    log, kept = Log("tracker", io.StringIO()), []
    for k in range(1000):
        line = Line(f"line {k}")
        kept.append(weakref.ref(line))
        log.seldom(line, "text")
    assert sum(line() is not None for line in kept) <= 257


def test_threads_may_log_while_another_writes_what_was_held_back():
    log, stop = Log("gateway", io.StringIO()), threading.Event()

    def say():
        k = 0
        while not stop.is_set():
            k += 1
            log.seldom(f"line {k}", "text")

    other, interval_s = threading.Thread(target=say), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    other.start()
    try:
        until = time.monotonic() + 0.5
        while time.monotonic() < until:
            log.flush()
    finally:
        sys.setswitchinterval(interval_s)
        stop.set()
        other.join()
