"""Starts the workers as processes, keeps them running, and stops them. Knows nothing of what they do.

A worker that dies, does not start in time, or gives no sign of life is killed and restarted, after a delay
that grows; after too many times in a window it is given up. One worker's end never ends another. The end of
a camera that plays a recording once is the end of the pipeline.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import msgspec

from huepose.support.words import listed
from huepose_services.runtime.config import Config
from huepose_services.runtime.log import Log, is_log_line, relayed, write
from huepose_services.runtime.pulse import COMPILING, READY_FD
from huepose_services.runtime.reload import Reload
from huepose_services.runtime.session import RESTARTS
from huepose_services.runtime.threads import THREAD_VARIABLES
from huepose_services.runtime.tied import SUPERVISOR
from huepose_services.runtime.worker import TELL_WHERE

# Variables that systemd sets for the supervisor, and its workers must not have.
_NOT_FOR_WORKERS = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM")
_TIME_TO_TELL_S = 0.15
_GONE_WITHIN_S = 0.5
"""A killed process has ended by then, unless the computer is busy or it waits for a device in the kernel."""
_DRAIN_S = 1.5
_STOP_WITHIN_S = 1.8
_HEAD_START_S = 0.1
"""The time for each worker to stop before those that it reads from are stopped as well."""
_BACKOFF_S, _BACKOFF_MAX_S = 0.25, 8.0
_STANDSTILL_S = 0.5
_FAILED, _BAD_INPUT = 1, 2
_HELD = "does not end yet: the computer is busy, or a device does not answer. It is restarted when it ends"
_MAPPED = (
    " (SIGBUS: a file that it uses was overwritten in place, such as a reference model; put a new one there "
    "by renaming it, docs/running.md)"
)
_WHY_IT_ENDED = "huepose run: "
"""How the command line begins the line of an error."""
_SILENT_S = 0.5
"""After this time of silence, it is measured how long a worker waits for a processor."""


class Starved:
    """How long a process has waited for a processor, from the kernel's statistics: on a busy computer a
    worker is silent for longer without hanging. pid: its number."""

    def __init__(self, pid: int) -> None:
        self._tasks = Path(f"/proc/{pid}/task")
        self._before = self._waits_ns()

    def since_last_s(self) -> float:
        """Seconds since the last call (or creation) in which a thread of the process was ready to run but
        had no processor; of the thread that waited longest. 0 if the kernel does not count it; a stopped or
        sleeping thread does not wait."""
        before, self._before = self._before, self._waits_ns()
        return max((now - before.get(thread, now) for thread, now in self._before.items()), default=0) * 1e-9

    def _waits_ns(self) -> dict[str, int]:
        """The second figure of each thread's schedstat (Linux, Documentation/scheduler/sched-stats)."""
        waits = {}
        # Threads end while this looks, and the process may be gone.
        with suppress(OSError):
            for task in self._tasks.iterdir():
                with suppress(OSError, ValueError, IndexError):
                    waits[task.name] = int((task / "schedstat").read_bytes().split()[1])
        return waits


class Child:
    """A worker's process. `ready`: it reported that it is ready; `runs`: its loop gave a sign of life;
    `heard`: when it was started or last gave one; `compiling`: it last reported that it waits for the
    compiler; `killed`: by the supervisor. Raises OSError or RuntimeError if another process cannot be
    started."""

    def __init__(self, worker: str, path: Path, out: TextIO, restarts: int, camera: str | None) -> None:
        self.worker, self._out = worker, out
        self._log_name = f"{camera}/{worker}" if camera else worker
        self.ready = self.runs = self.compiling = self.killed = False
        self.started = self.heard = time.monotonic()
        read_end, write_end = os.pipe()
        environment = {
            **{name: value for name, value in os.environ.items() if name not in _NOT_FOR_WORKERS},
            **dict.fromkeys(THREAD_VARIABLES, "1"),
            READY_FD: str(write_end),
            SUPERVISOR: str(os.getpid()),
            RESTARTS: str(restarts),
        }
        which = f"{camera}.{worker}" if camera else worker
        self.pipe: int | None = read_end
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "huepose_services.cli.main", "run", which, str(path)],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(write_end,),
                # Ctrl-C at the terminal reaches the supervisor alone, which then stops the workers in order.
                start_new_session=True,
            )
        except OSError:
            self._close_pipe()
            raise
        finally:
            os.close(write_end)
        os.set_blocking(read_end, False)
        self._starved: Starved | None = None
        self._reader = threading.Thread(target=self._copy_log, daemon=True)
        try:
            self._reader.start()
        except RuntimeError:
            self.kill()
            self._close_pipe()
            raise

    def _copy_log(self) -> None:
        """Copy its log lines, lines of libraries as lines of the worker with repeats held back,
        and the reason of its end as an error."""
        assert self.process.stdout is not None
        foreign = Log(self._log_name, self._out)
        for raw in self.process.stdout:
            line = raw.decode(errors="replace")
            if is_log_line(line):
                write(self._out, relayed(line))
            elif line.startswith(_WHY_IT_ENDED):
                foreign.error(line.removeprefix(_WHY_IT_ENDED).rstrip())
            elif line.strip():
                foreign.seldom(line, line.rstrip())

    def listen(self) -> None:
        """Read what came through the pipe."""
        if self.pipe is None:
            return
        try:
            data = os.read(self.pipe, 4096)
        except BlockingIOError:
            return
        if not data:
            self._close_pipe()
            return
        self.heard = time.monotonic()
        self._starved = None
        self.runs = True
        self.compiling = data.endswith(COMPILING)
        self.ready = self.ready or b"ready" in data

    def forgive_starving(self) -> None:
        """Do not count the time in which it waited for a processor in its silence, or in its start."""
        now = time.monotonic()
        if self._starved is not None:
            waited_s = self._starved.since_last_s()
            self.started, self.heard = min(now, self.started + waited_s), min(now, self.heard + waited_s)
        elif now - self.heard > _SILENT_S:
            self._starved = Starved(self.process.pid)

    def ended_within(self, seconds: float) -> bool:
        """Wait for its end, for at most this time; whether it has ended."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(max(0.0, seconds))
            return True
        return False

    def kill(self, ask_where: bool = False) -> bool:
        """Kill it; returns whether it has ended. `ask_where`: first let it write a stack trace to the log."""
        self.killed, self.ready = True, False
        if ask_where:
            self.process.send_signal(TELL_WHERE)
            self.ended_within(_TIME_TO_TELL_S)
        self.process.kill()
        return self.ended_within(_GONE_WITHIN_S)

    def clean_up(self, patience_s: float) -> None:
        """After its end: close its pipe and read the rest of its log."""
        self._close_pipe()
        self._reader.join(patience_s)

    def _close_pipe(self) -> None:
        if self.pipe is not None:
            os.close(self.pipe)
            self.pipe = None


@dataclass
class _Record:
    """The deaths of a worker, and when it is started again."""

    deaths: deque[float] = field(default_factory=deque)
    silences: deque[float] = field(default_factory=deque)
    """The deaths because it gave no sign of life."""
    restart_at: float | None = None
    restarts: int = 0


class Supervisor:
    """All workers of one configuration. Call `start`, then `poll` often, then `stop`.

    of: their camera, for the log, if the file has several."""

    def __init__(self, config: Config, path: Path, out: TextIO | None = None, of: str | None = None) -> None:
        self._config, self._path = config, path
        self._out = out or sys.stderr
        self._log = Log(f"{of}/huepose" if of else "huepose", self._out)
        self._of = of
        self._reload = Reload("huepose", path, config, self._log)
        self._read_again: set[str] = set()
        self._children: dict[str, Child] = {}
        self._records: dict[str, _Record] = {worker: _Record() for worker in config.workers}
        self.exit_code: int | None = None
        """Set by poll when the pipeline has come to its end: 0, 1 or 2."""
        self._drain_until: float | None = None
        self._ends_with = 0
        self._was_ready = False
        self._polled = time.monotonic()

    @property
    def not_ready(self) -> set[str]:
        """The workers that do not run, or have not reported yet that they are ready."""
        return {w for w in self._records if w not in self._children or not self._children[w].ready}

    @property
    def ready(self) -> bool:
        """Whether every worker runs and has reported that it is ready."""
        return not self.not_ready

    def start(self) -> None:
        """Start every worker."""
        for worker in self._records:
            self._spawn(worker)

    def _spawn(self, worker: str) -> None:
        record = self._records[worker]
        record.restart_at = None
        try:
            self._children[worker] = Child(worker, self._path, self._out, record.restarts, self._of)
        except (OSError, RuntimeError) as error:
            self._put_off(worker, f"could not be started ({error})")

    def reload(self) -> None:
        """Read the configuration again, and have every worker do so, as soon as it is ready."""
        new = self._reload.take_over(lambda _: [])
        if new is not None:
            over = [worker for worker in self._records if self._is_given_up(worker)]
            all_but = f"all workers but {listed(over)}, given up," if over else "all workers"
            self._log.say(f"{all_but} read the configuration again")
            self._config = msgspec.structs.replace(self._config, restarts=new.restarts)
            self._read_again = set(self._records)

    def _is_given_up(self, worker: str) -> bool:
        return worker not in self._children and self._records[worker].restart_at is None

    def poll(self, timeout_s: float = 0.1) -> None:
        """Supervise the workers for timeout_s: readiness, signs of life, deaths, restarts, the end."""
        pipes = [c.pipe for c in self._children.values() if c.pipe is not None]
        select.select(pipes, [], [], timeout_s)  # until one writes, or its pipe closes because it died
        self._forgive_standstill(timeout_s)
        for child in list(self._children.values()):
            child.listen()
            child.forgive_starving()
            if child.ready and child.worker in self._read_again:
                self._read_again.discard(child.worker)
                child.process.send_signal(signal.SIGHUP)
            code = child.process.poll()
            if code is not None:
                self._on_end(child, None if child.killed else code)
            elif not child.killed and (fault := self._fault(child)) is not None:
                self._log.error(f"{child.worker} {fault}: killed")
                if child.kill(ask_where=True):
                    self._on_end(child, None)
                else:
                    self._log.error(f"{child.worker} {_HELD}")
        if self.ready and not self._was_ready:
            self._log.say("all workers are ready")
        self._was_ready = self.ready
        now = time.monotonic()
        for worker, record in self._records.items():
            if record.restart_at is not None and now >= record.restart_at and self._drain_until is None:
                record.restarts += 1
                self._log.say(f"starting {worker} again (restart {record.restarts})")
                self._spawn(worker)
        if self._drain_until is not None:
            self.exit_code = self._ends_with if now >= self._drain_until else self.exit_code
        elif all(map(self._is_given_up, self._records)):
            self.exit_code = 1 if self.exit_code is None else self.exit_code

    def _forgive_standstill(self, timeout_s: float) -> None:
        """Do not count a time in which this process did not run: its workers may not have run either."""
        now = time.monotonic()
        standstill_s = now - self._polled - timeout_s
        self._polled = now
        if standstill_s > _STANDSTILL_S:
            for child in self._children.values():
                child.started += standstill_s
                child.heard += standstill_s

    def _fault(self, child: Child) -> str | None:
        """What is wrong with a running worker; None if nothing is."""
        limits, now = self._config.restarts, time.monotonic()
        if not child.runs:
            late = now - child.started > limits.start_within_s
            return f"is not ready after {limits.start_within_s:g} s" if late else None
        if child.compiling:
            late = now - child.heard > limits.start_within_s
            return f"has compiled for more than {limits.start_within_s:g} s" if late else None
        silences = self._records[child.worker].silences
        while silences and now - silences[0] > limits.window_s:
            silences.popleft()
        # Twice the patience after each time, so that work which is only slow can end.
        patience_s = limits.patience_s(child.worker) * 2 ** len(silences)
        silent_s = now - child.heard
        if silent_s <= patience_s:
            return None
        silences.append(now)
        return f"has given no sign of life for {silent_s:.1f} s"

    def _on_end(self, child: Child, code: int | None) -> None:
        """A worker has ended (code None: it was killed here): end the pipeline, or restart the worker."""
        del self._children[child.worker]
        child.clean_up(1.0)
        now, record = time.monotonic(), self._records[child.worker]
        if code == _BAD_INPUT and not child.ready and record.restarts == 0:
            # It has reported what is wrong with its input, which a restart would not change.
            self.exit_code = _BAD_INPUT
            return
        if child.worker == "camera" and code in (0, _BAD_INPUT) and self._config.camera.once:
            if self._drain_until is None:
                self._log.say("the recording has ended" + (", with an error" if code else ""))
                self._drain_until, self._ends_with = now + _DRAIN_S, _FAILED if code else 0
            return
        how = "was killed" if code is None else f"ended with code {code}"
        if code is not None and code < 0:
            how = f"killed by signal {-code}{_MAPPED if code == -signal.SIGBUS else ''}"
        self._put_off(child.worker, how)

    def _put_off(self, worker: str, how: str) -> None:
        """A worker has died, or could not be started: restart it later, unless that was too often."""
        now, record = time.monotonic(), self._records[worker]
        window, limit = self._config.restarts.window_s, self._config.restarts.limit
        record.deaths.append(now)
        while now - record.deaths[0] > window:
            record.deaths.popleft()
        if len(record.deaths) > limit:
            self._log.error(
                f"{worker} {how}: given up after {limit} restarts in {window:g} s. Mend what it said last, "
                "then start the pipeline again"
            )
            return
        wait_s = min(_BACKOFF_S * 2 ** (len(record.deaths) - 1), _BACKOFF_MAX_S)
        record.restart_at = now + wait_s
        self._log.warn(f"{worker} {how}: starting it again in {wait_s:g} s")

    def stop(self) -> None:
        """Stop every worker within two seconds, readers before the workers that they read from."""
        deadline = time.monotonic() + _STOP_WITHIN_S
        children = [self._children[w] for w in reversed(self._records) if w in self._children]
        for child in children:
            child.process.terminate()
            child.ended_within(_HEAD_START_S)
        for child in children:
            if not child.ended_within(deadline - time.monotonic()):
                self._log.error(f"{child.worker} does not stop: killed")
                child.kill()
            child.clean_up(0.2)
        self._children.clear()
