"""One worker process: open the session, make the work, then wait, step and say how it is, until told to stop.

A worker under a supervisor finds two variables: HUEPOSE_READY_FD, a pipe on which one line says that it
is ready, and HUEPOSE_SUPERVISOR, the process that it must not outlive.
"""

from __future__ import annotations

import os
import signal
import traceback
from contextlib import suppress
from importlib import import_module
from types import FrameType
from typing import Protocol, cast

import cv2
import zenoh

from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.session import open_worker_session

READY_FD = "HUEPOSE_READY_FD"
SUPERVISOR = "HUEPOSE_SUPERVISOR"

_HOMES = {
    "camera": "huepose_services.camera.ingest",
    "tracker": "huepose_services.tracker",
    "reinit": "huepose_services.reinit",
    "detector": "huepose_services.detector",
    "segmenter": "huepose_services.segmenter",
    "estimator": "huepose_services.estimator",
}
# Frames and tracking come first where the cores do not suffice for all and the system allows it.
_NICENESS = {"camera": -5, "tracker": -5}
_LONGEST_WAIT_S = 0.1
_FORCED_STOP_AFTER_S = 1.0
_ERRORS_IN_A_ROW = 10


class Work(Protocol):
    """What one worker does. Made by `make(bus, config)` of its module, warmed up when that returns."""

    finished: bool
    """Set when there is nothing left to do: the worker then ends with exit code 0."""

    def step(self) -> None:
        """Do what is due: called when something arrived, when `due_ns` has come, and now and then."""
        ...

    def due_ns(self) -> int | None:
        """When to be called at the latest; None to be called for arrivals only."""
        ...


class _Stop:
    """The request to stop, from SIGTERM or SIGINT; a second later work that did not notice is cut off."""

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
        # Nothing is lost: the bus notices that the links close, and other threads may not be waited for.
        self._log.say("stopped in the middle of its work")
        os._exit(0)


def run_worker(worker: str, config: Config) -> int:
    """Run a worker until SIGTERM, SIGINT, its supervisor's end or its own. Returns the exit code.

    Raises InputError for what the configuration names and is not there, or a port that is taken."""
    log, health = Log(worker), Health(worker)
    stop = _Stop(log)
    with suppress(PermissionError):
        os.nice(_NICENESS.get(worker, 0))
    cv2.setNumThreads(1)
    session, health.warnings = open_worker_session(config, worker)
    for warning in health.warnings:
        log.say(f"warning: {warning}")
    bus = Bus(session, config.keys, worker, log, health)
    try:
        bus.put(config.keys.health(worker), health.message())
        work = cast(Work, import_module(_HOMES[worker]).make(bus, config))
        token = session.liveliness().declare_token(config.keys.live(worker))
        health.state = "ready"
        _tell_supervisor()
        log.say("ready")
        _loop(bus, work, stop)
        health.state = "ended" if work.finished else "stopping"
        bus.put(config.keys.health(worker), health.message())
        token.undeclare()  # type: ignore[no-untyped-call]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        _close(bus, session)
    return 0


def _loop(bus: Bus, work: Work, stop: _Stop) -> None:
    supervisor = int(os.environ.get(SUPERVISOR, 0))
    errors = 0
    next_health_ns = now_ns()
    while not stop.requested and not work.finished:
        due_ns = work.due_ns()
        until_ns = next_health_ns if due_ns is None else min(due_ns, next_health_ns)
        bus.inbox.wait(min((until_ns - now_ns()) / SECOND, _LONGEST_WAIT_S))
        try:
            work.step()
            errors = 0
        except Exception:
            errors += 1
            bus.health.count("errors")
            bus.log.seldom("error", f"error in its work, going on:\n{traceback.format_exc()}")
            if errors >= _ERRORS_IN_A_ROW:
                raise
        if now_ns() >= next_health_ns:
            next_health_ns = max(next_health_ns + SECOND, now_ns())
            bus.put(bus.keys.health(bus.worker), bus.health.message())
            if supervisor and os.getppid() != supervisor:
                bus.log.say("the supervisor is gone: stopping")
                return


def _tell_supervisor() -> None:
    if READY_FD in os.environ:
        with os.fdopen(int(os.environ[READY_FD]), "w") as pipe:
            pipe.write("ready\n")


def _close(bus: Bus, session: zenoh.Session) -> None:
    bus.close()
    session.close()  # type: ignore[no-untyped-call]
