"""Starts the workers as processes, keeps them running, and stops them. Knows nothing of what they do.

One worker's death never ends another: it is started again, later and later, and given up after too many
deaths in a window. The end of a camera that plays a recording once is the end of the pipeline.
"""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from huepose_services.runtime.config import Config
from huepose_services.runtime.log import Log
from huepose_services.runtime.threads import THREAD_VARIABLES
from huepose_services.runtime.worker import READY_FD, SUPERVISOR

_DRAIN_S = 1.5
_STOP_WITHIN_S = 1.8
_BACKOFF_S, _BACKOFF_MAX_S = 0.25, 8.0
_BAD_INPUT = 2


@dataclass
class _Child:
    worker: str
    process: subprocess.Popen[bytes]
    ready_pipe: int | None
    ready: bool = False
    reader: threading.Thread | None = None


@dataclass
class _Record:
    """The deaths of a worker, and when it is started again."""

    deaths: deque[float] = field(default_factory=deque)
    restart_at: float | None = None
    restarts: int = 0


class Supervisor:
    """All workers of one configuration. Call `start`, then `poll` often, then `stop`."""

    def __init__(self, config: Config, path: Path, out: TextIO | None = None) -> None:
        self._config, self._path = config, path
        self._out = out or sys.stderr
        self._log = Log("huepose")
        self._children: dict[str, _Child] = {}
        self._records: dict[str, _Record] = {worker: _Record() for worker in config.workers}
        self.exit_code: int | None = None
        """Set by poll when the pipeline has come to its end: 0, 1 or 2."""
        self._drain_until: float | None = None

    @property
    def ready(self) -> bool:
        """Whether every worker is running and has said that it is ready."""
        return len(self._children) == len(self._records) and all(c.ready for c in self._children.values())

    @property
    def processes(self) -> dict[str, int]:
        """Process numbers of the workers that run."""
        return {name: child.process.pid for name, child in self._children.items()}

    def start(self) -> None:
        """Start every worker."""
        for worker in self._records:
            self._spawn(worker)

    def _spawn(self, worker: str) -> None:
        read_end, write_end = os.pipe()
        environment = {
            **os.environ,
            **dict.fromkeys(THREAD_VARIABLES, "1"),
            READY_FD: str(write_end),
            SUPERVISOR: str(os.getpid()),
        }
        command = [sys.executable, "-m", "huepose_services.cli.main", "run", worker, str(self._path)]
        process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=(write_end,),
            # A Ctrl-C at the terminal reaches the supervisor alone, which then stops all in its order.
            start_new_session=True,
        )
        os.close(write_end)
        os.set_blocking(read_end, False)
        child = _Child(worker, process, read_end)
        child.reader = threading.Thread(target=self._copy_log, args=(process,), daemon=True)
        child.reader.start()
        self._children[worker] = child
        self._records[worker].restart_at = None

    def _copy_log(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._out.write(line.decode(errors="replace"))
            self._out.flush()

    def poll(self, timeout_s: float = 0.1) -> None:
        """Look after the workers for a while: readiness, deaths, restarts, the end."""
        self._wait_for_something(timeout_s)
        now = time.monotonic()
        for child in list(self._children.values()):
            self._read_ready(child)
            code = child.process.poll()
            if code is not None:
                self._bury(child, code, now)
        for worker, record in self._records.items():
            if record.restart_at is not None and now >= record.restart_at and self._drain_until is None:
                record.restarts += 1
                self._log.say(f"starting {worker} again (restart {record.restarts})")
                self._spawn(worker)
        if self._drain_until is not None:
            self.exit_code = 0 if now >= self._drain_until else self.exit_code
        elif not self._children and all(r.restart_at is None for r in self._records.values()):
            self.exit_code = 1 if self.exit_code is None else self.exit_code

    def _wait_for_something(self, timeout_s: float) -> None:
        """Sleep until a worker says ready or closes its pipe by dying before it, at most so long."""
        pipes = [c.ready_pipe for c in self._children.values() if c.ready_pipe is not None]
        if not pipes:
            time.sleep(timeout_s)
            return
        with selectors.DefaultSelector() as selector:
            for pipe in pipes:
                selector.register(pipe, selectors.EVENT_READ)
            selector.select(timeout_s)

    def _read_ready(self, child: _Child) -> None:
        if child.ready_pipe is None:
            return
        try:
            text = os.read(child.ready_pipe, 64)
        except BlockingIOError:
            return
        os.close(child.ready_pipe)
        child.ready_pipe = None
        child.ready = text.startswith(b"ready")
        if child.ready and self.ready:
            self._log.say("all workers are ready")

    def _bury(self, child: _Child, code: int, now: float) -> None:
        """A worker has ended: the end of the pipeline, or something to be started again."""
        del self._children[child.worker]
        if child.ready_pipe is not None:
            os.close(child.ready_pipe)
        if child.reader is not None:
            child.reader.join(1.0)
        record = self._records[child.worker]
        if child.worker == "camera" and code == 0 and self._config.camera.once:
            if self._drain_until is None:
                self._log.say("the recording has ended")
                self._drain_until = now + _DRAIN_S
            return
        if code == _BAD_INPUT and not child.ready:
            self.exit_code = _BAD_INPUT
            return
        how = f"killed by signal {-code}" if code < 0 else f"ended with code {code}"
        window, limit = self._config.restarts.window_s, self._config.restarts.limit
        record.deaths.append(now)
        while now - record.deaths[0] > window:
            record.deaths.popleft()
        if len(record.deaths) > limit:
            self._log.say(f"{child.worker} {how}: given up after {limit} restarts in {window:g} s")
            return
        wait_s = min(_BACKOFF_S * 2 ** (len(record.deaths) - 1), _BACKOFF_MAX_S)
        record.restart_at = now + wait_s
        self._log.say(f"{child.worker} {how}: starting it again in {wait_s:g} s")

    def stop(self) -> None:
        """Stop every worker, within two seconds."""
        for child in self._children.values():
            if child.process.poll() is None:
                child.process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _STOP_WITHIN_S
        for child in self._children.values():
            try:
                child.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                self._log.say(f"{child.worker} does not stop: killed")
                child.process.kill()
                child.process.wait()
            if child.ready_pipe is not None:
                os.close(child.ready_pipe)
            if child.reader is not None:
                child.reader.join(0.2)
        self._children.clear()
