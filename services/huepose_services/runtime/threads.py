"""What a process takes of the computer: the processors that it may use, and one thread of the numeric
libraries, because six workers share few cores and waiting threads spin.

The estimator's two objects at a time are threads of its own, above the libraries. (With two BLAS threads its
work takes twice the CPU time.)
"""

from __future__ import annotations

import os
from collections.abc import Collection

from huepose.support.errors import InputError

# Read by the libraries when they are imported.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def single_threaded() -> None:
    """Before numpy is imported; what the user has set holds."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")


def check_processors(processors: Collection[int]) -> None:
    """Raises InputError for one that this process may not use."""
    allowed = os.sched_getaffinity(0)
    if strange := sorted(set(processors) - allowed):
        raise InputError(
            "cpus",
            found=", ".join(map(str, strange)),
            expected=f"processors of this computer that the pipeline may use: {sorted(allowed)}",
        )
