"""The processors that a process may use, and one thread for the numeric libraries: six workers share few
cores, and waiting threads of these libraries spin.

The estimator works on two objects at a time with threads of its own. (With two BLAS threads its work takes
twice the CPU time.)
"""

from __future__ import annotations

import os
from collections.abc import Collection

from huepose.support.errors import InputError

# The libraries read these when they are imported.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def single_threaded() -> None:
    """To be called before numpy is imported; values that the user has set are kept."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")


def check_processors(processors: Collection[int]) -> None:
    """Raises InputError for processors that this process may not use."""
    allowed = os.sched_getaffinity(0)
    if forbidden := sorted(set(processors) - allowed):
        raise InputError(
            "cpus",
            found=", ".join(map(str, forbidden)),
            expected=f"processors of this computer that the pipeline may use: {sorted(allowed)}",
        )
