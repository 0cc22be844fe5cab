"""Limit the numeric libraries to one thread per process: six workers share few cores, and waiting threads
spin.

The estimator's two objects at a time are threads of its own, above the libraries. (With two BLAS threads its
work takes twice the CPU time.)
"""

from __future__ import annotations

import os

# Read by the libraries when they are imported.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def single_threaded() -> None:
    """Before numpy is imported; what the user has set holds."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")
