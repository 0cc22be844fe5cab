"""End a worker together with the process that started it, however that one ended, so that no orphan keeps a
port.

The kernel says so by a signal, so a worker that hangs ends as well. SIGKILL is right for all that only
compute: the bus notices at once. A camera is asked first, because one that is not let go has to be plugged in
anew; what it has not let go after `GRACE_S` it never will.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import threading
import time

SUPERVISOR = "HUEPOSE_SUPERVISOR"
"""The variable with the number of the process that a worker must not outlive."""
_PR_SET_PDEATHSIG = 1
GRACE_S = 1.2


def end_with(parent: int, ask_first: bool) -> None:
    """From now on this process ends with its parent; `ask_first`: by SIGTERM, then by force.

    The parent's thread that started this process must be one that lives as long as the parent."""
    how = signal.SIGTERM if ask_first else signal.SIGKILL
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, int(how), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() != parent:
        # It ended before the kernel was told.
        os.kill(os.getpid(), signal.SIGKILL)
    if ask_first:
        threading.Thread(target=_force, args=(os.pidfd_open(parent),), daemon=True).start()


def _force(parent_fd: int) -> None:
    select.select([parent_fd], [], [])
    time.sleep(GRACE_S)
    os.kill(os.getpid(), signal.SIGKILL)
