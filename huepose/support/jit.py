"""The one way to compile a numeric kernel: numba, cached on disk where a cache folder can be written.

Where neither site-packages nor the home folder is writable (a hardened service), numba refuses at
import to cache; such a kernel is compiled without a cache then, and a line says so and names the variable to
set.

Numba takes a cached kernel for fresh while its own source file is the same, though it holds the machine code
of every kernel that it calls. Here a kernel is fresh while all source files with kernels are.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

KERNELS: set[str] = set()
"""The names of all kernels of the modules that were imported so far."""

NOT_KEPT: set[str] = set()
"""Those of them that are compiled anew at each start."""


def name_of(function: Callable[..., Any]) -> str:
    """As in KERNELS."""
    return f"{function.__module__}.{function.__qualname__}"


def jit(function: F) -> F:
    """Compile `function` in nopython mode, releasing the interpreter lock, with fast floating point."""
    return _compiled(function, {})


def jit_dividing(function: F) -> F:
    """The same, and a division by zero gives inf or nan as in NumPy where `jit` raises: without that check in
    the way, the compiler works on several numbers at once."""
    return _compiled(function, {"error_model": "numpy"})


def _compiled(function: F, more: dict[str, Any]) -> F:
    KERNELS.add(name_of(function))
    options: dict[str, Any] = {"nogil": True, "fastmath": {"contract", "arcp", "nsz", "reassoc"}, **more}
    try:
        kernel = numba.njit(cache=True, **options)(function)
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        if not NOT_KEPT:
            text = (
                "kernels are compiled anew at each start, which takes up to two minutes: there is no folder "
                "to keep them in. Set NUMBA_CACHE_DIR to one that can be written"
            )
            print(text, file=sys.stderr, flush=True)
        NOT_KEPT.add(name_of(function))
        return cast(F, numba.njit(**options)(function))
    if not numba.config.DISABLE_JIT:  # else it is the function itself
        kernel._cache._cache_file._source_stamp = kernel_sources()
        _forgive(kernel._cache)
    return cast(F, kernel)


def _forgive(kept: Any) -> None:
    """Compile anew where a cache names modules or classes that are no more: an older version of the package
    wrote it."""
    load = kept.load_overload

    def load_overload(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except (ImportError, AttributeError):
            kept._cache_file.flush()
            return None

    kept.load_overload = load_overload


@cache
def kernel_sources() -> str:
    """A digest of all source files of the package that hold kernels."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        text = path.read_bytes()
        if b"support.jit import" in text:
            digest.update(text)
    return digest.hexdigest()
