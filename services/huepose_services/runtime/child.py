"""One worker as a process of the supervisor: how it is started, its pulse, its log, its end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from huepose_services.runtime.log import Log, is_log_line
from huepose_services.runtime.pulse import COMPILING, READY_FD
from huepose_services.runtime.session import RESTARTS
from huepose_services.runtime.threads import THREAD_VARIABLES
from huepose_services.runtime.tied import SUPERVISOR
from huepose_services.runtime.worker import TELL_WHERE

# What systemd told the supervisor is not meant for its workers.
_NOT_FOR_WORKERS = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM")
_TIME_TO_TELL_S = 0.15


class Child:
    """A worker's process. `ready`: it said so; `runs`: its loop gave a sign of life; `heard`: when it was
    started or last gave one; `compiling`: that it waits for the compiler is the last that it said."""

    def __init__(self, worker: str, path: Path, out: TextIO, restarts: int, camera: str | None) -> None:
        self.worker, self._out = worker, out
        self._says = f"{camera}/{worker}" if camera else worker
        self.ready = self.runs = self.compiling = False
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
        self.process = subprocess.Popen(
            [sys.executable, "-m", "huepose_services.cli.main", "run", which, str(path)],
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
        self.pipe: int | None = read_end
        self._reader = threading.Thread(target=self._copy_log, daemon=True)
        self._reader.start()

    def _copy_log(self) -> None:
        """Its log lines as they are; what libraries print as lines of the worker, repeats held back."""
        assert self.process.stdout is not None
        foreign = Log(self._says, self._out)
        for raw in self.process.stdout:
            line = raw.decode(errors="replace")
            if is_log_line(line):
                self._out.write(line)
                self._out.flush()
            elif line.strip():
                foreign.seldom(line, line.rstrip())

    def listen(self) -> None:
        """Take in what came through the pipe."""
        if self.pipe is None:
            return
        try:
            said = os.read(self.pipe, 4096)
        except BlockingIOError:
            return
        if not said:
            self._close_pipe()
            return
        self.heard = time.monotonic()
        self.runs = True
        self.compiling = said.endswith(COMPILING)
        self.ready = self.ready or b"ready" in said

    def ask_to_stop(self) -> None:
        """SIGTERM, where it still runs."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)

    def ended_within(self, seconds: float) -> bool:
        """Wait for its end, at most so long."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(max(0.0, seconds))
            return True
        return False

    def kill(self, ask_where: bool = False) -> None:
        """End it at once; `ask_where`: first let it write to the log what it is doing."""
        if ask_where:
            self.process.send_signal(TELL_WHERE)
            self.ended_within(_TIME_TO_TELL_S)
        self.process.kill()
        self.process.wait()

    def bury(self, patience_s: float) -> None:
        """After its end: let go of its pipe and read the rest of its log."""
        self._close_pipe()
        self._reader.join(patience_s)

    def _close_pipe(self) -> None:
        if self.pipe is not None:
            os.close(self.pipe)
            self.pipe = None
