"""Which kernels are compiled, for tests of warm-ups."""

from __future__ import annotations

import gc

from numba.core.dispatcher import Dispatcher


def compiled() -> dict[str, int]:
    """How often each kernel was compiled, or read from the cache: once for each layout of its arrays."""
    kernels = [k for k in gc.get_objects() if issubclass(type(k), Dispatcher)]
    return {f"{k.py_func.__module__}.{k.py_func.__name__}": len(k.signatures) for k in kernels}
