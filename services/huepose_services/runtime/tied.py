"""End a worker together with the process that started it, in whatever way that one ended, so that no orphan
keeps a port.

The kernel sends a signal, so a worker that hangs ends as well. SIGKILL is right for workers that only
compute: the bus notices at once. A camera worker gets SIGTERM first, because a camera that is not released
has to be plugged in again; after `GRACE_S` it is killed.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import threading
import time

SUPERVISOR = "HUEPOSE_SUPERVISOR"
"""The environment variable with the number of the process that a worker must not outlive."""
_PR_SET_PDEATHSIG = 1
GRACE_S = 1.2


def end_with(parent: int, ask_first: bool) -> None:
    """From now on this process ends with its parent; `ask_first`: by SIGTERM, then by SIGKILL.

    The parent's thread that started this process must live as long as the parent."""
    how = signal.SIGTERM if ask_first else signal.SIGKILL
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(how), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() != parent:
        # The parent ended before the call of prctl.
        os.kill(os.getpid(), signal.SIGKILL)
    if ask_first:
        threading.Thread(target=_force, args=(os.pidfd_open(parent),), daemon=True).start()


def _force(parent_fd: int) -> None:
    select.select([parent_fd], [], [])
    time.sleep(GRACE_S)
    os.kill(os.getpid(), signal.SIGKILL)
