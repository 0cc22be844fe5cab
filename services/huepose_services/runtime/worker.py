"""One worker process: open the session, make the work, then wait, step and publish health, until it is
stopped.

Under a supervisor the heartbeat goes through a pipe, under systemd it is READY=1 and WATCHDOG=1.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
import traceback
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import cast

import cv2

from huepose.support.errors import InputError
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config, WorkerName
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.pulse import Pulse
from huepose_services.runtime.reload import Reload, asked_again
from huepose_services.runtime.session import open_worker_session
from huepose_services.runtime.threads import check_processors
from huepose_services.runtime.work import Work

TELL_WHERE = signal.SIGUSR2

# Frames and tracking come first if there are too few cores. Raising a priority needs permission (root,
# LimitNICE of a unit); lowering that of perception and of workers that only read does not. A slow recorder
# would hold the camera's frame buffers until none is left.
_NICENESS = {
    **{"camera": -5, "tracker": -5, "record": -5, "reinit": -2},
    **{"detector": 3, "segmenter": 3, "estimator": 3},
}
_NICENESS_OF_OTHERS = 3
_LONGEST_WAIT_S = 0.1
_FORCED_STOP_AFTER_S = 1.0
_ERRORS_IN_A_ROW = 10


class _Stop:
    """The request to stop, from SIGTERM or SIGINT; a worker that does not stop within a second is ended."""

    def __init__(self, log: Log) -> None:
        self.requested = False
        self._log = log
        signal.signal(signal.SIGTERM, self._ask)
        signal.signal(signal.SIGINT, self._ask)
        signal.signal(signal.SIGALRM, self._force)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        signal.setitimer(signal.ITIMER_REAL, _FORCED_STOP_AFTER_S)

    def _force(self, number: int, frame: FrameType | None) -> None:
        # Nothing is lost: the bus notices that the links close; other threads may never end, so do not wait.
        self._log.say("stopped; what it was working on is dropped")
        os._exit(0)


def home_of(worker: str) -> str:
    """The name of the module with a worker's `make`."""
    return "huepose_services." + ("camera.ingest" if worker == "camera" else worker)


def come_first(worker: str) -> None:
    """Give this process the priority of this worker, as far as it is permitted."""
    with suppress(PermissionError):
        os.nice(_NICENESS.get(worker, _NICENESS_OF_OTHERS))
    # If the kernel shares time among sessions (sched_autogroup), niceness counts only within a session, and
    # the session's own value against others. This session has no other process.
    if os.getsid(0) == os.getpid():
        with suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(os.nice(0)))


def keep_to(processors: Collection[int]) -> None:
    """Run this process and its later threads on these processors only; if there are none, on any. Raises
    InputError for a processor that it may not use."""
    check_processors(processors)
    if processors:
        os.sched_setaffinity(0, processors)


def run_worker(worker: str, config: Config, path: Path, of: str | None) -> int:
    """Run a worker until SIGTERM, SIGINT, its supervisor's end or its own; path: of the configuration, which
    is read again at SIGHUP; of: its camera, if the file has several, for the log. Returns the exit code.

    Raises InputError if something that the configuration names is missing or does not work, or a port is
    taken."""
    log, health = Log(f"{of}/{worker}" if of else worker), Health(worker)
    health.much_locked_mib = max(health.much_locked_mib, 10.0 * config.bus.frame_pool_mib)
    stop, again = _Stop(log), asked_again()
    # Before the supervisor kills a worker that hangs, it asks for a stack trace.
    faulthandler.register(TELL_WHERE, file=sys.stderr, all_threads=True)
    come_first(worker)
    keep_to(config.cpus.get(cast(WorkerName, worker), ()))
    cv2.setNumThreads(1)
    session, warning = open_worker_session(config, worker)
    if warning is not None:
        log.warn(warning)
        health.warn_while("session", warning)
    bus = Bus(session, config.keys, worker, log, health)
    pulse = Pulse()
    try:
        bus.say_health()
        work = _made(worker, bus, config)
        try:
            # All that is loaded by now stays. Garbage collection that looks through it would delay the work,
            # the estimator's by a sixth of a second.
            gc.collect()
            gc.freeze()
            if "numba" in sys.modules:
                import_module("huepose_services.runtime.compiling").tell_of_late_compiling(pulse, health, log)
            token = session.liveliness().declare_token(config.keys.live(worker))
            reload = Reload(worker, path, config, log, health)
            _loop(bus, work, stop, pulse, lambda: again() and reload.take_over(work.reload))
        finally:
            pulse.stopping()
            _close(work, log)
        health.state = "ended" if work.finished else "stopping"
        bus.say_health()
        token.undeclare()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        bus.close()
        session.close()
    if work.fault is not None:
        raise work.fault
    return 0


def _close(work: Work, log: Log) -> None:
    """Close the work, however its loop has ended; an error in closing is logged, so that it does not hide the
    error that ended the loop."""
    try:
        work.close()
    except Exception:
        log.error(f"error in closing:\n{traceback.format_exc()}")


def _made(worker: str, bus: Bus, config: Config) -> Work:
    """The worker's work, warmed up; the log says if kernels have to be compiled for that."""
    home = import_module(home_of(worker))
    telling: AbstractContextManager[object] = nullcontext()
    if "numba" in sys.modules:
        telling = import_module("huepose.support.compiling").telling_of_compiling(bus.log.say)
    with telling:
        work: Work = home.make(bus, config)
    return work


def _loop(bus: Bus, work: Work, stop: _Stop, pulse: Pulse, reload: Callable[[], object]) -> None:
    errors = 0
    next_health_ns = now_ns()
    said_ready = False
    pulse.running()
    while not stop.requested and not work.finished:
        if not said_ready and work.ready:
            said_ready = True
            if bus.health.state == "starting":
                bus.health.state = "ready"
            bus.log.say("ready")
            pulse.ready()
        due_ns = work.due_ns()
        until_ns = next_health_ns if due_ns is None else min(due_ns, next_health_ns)
        bus.inbox.wait(min((until_ns - now_ns()) / SECOND, _LONGEST_WAIT_S))
        try:
            reload()
            work.step()
            errors = 0
        except Exception as error:
            errors += 1
            bus.health.count("errors")
            bus.health.failed(f"{type(error).__name__}: {error}")
            # An InputError says itself what is wrong; other errors need a stack trace.
            details = f" {error}" if isinstance(error, InputError) else f"\n{traceback.format_exc()}"
            bus.log.seldom("error", f"error in its work, going on:{details}", level="error")
            if errors >= _ERRORS_IN_A_ROW:
                raise
        pulse.beat()
        if now_ns() >= next_health_ns:
            next_health_ns = max(next_health_ns + SECOND, now_ns())
            bus.say_health()
