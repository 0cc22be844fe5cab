"""The only way to compile a numeric kernel: numba, cached on disk if a cache folder can be written.

If neither site-packages nor the home folder is writable (a hardened service), numba refuses to cache and
raises at import. Then the kernel is compiled without a cache, and a line says so and names the variable to
set.

A cached kernel contains the machine code of all kernels that it calls, but numba uses it as long as its own
source file is unchanged. Here it is used only as long as all source files with kernels are unchanged.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

KERNELS: set[str] = set()
"""Names of all kernels in the modules that are imported so far."""

NOT_KEPT: set[str] = set()
"""Names of the kernels that are not cached, but compiled again at each start."""


def name_of(function: Callable[..., Any]) -> str:
    """The name of a kernel in KERNELS."""
    return f"{function.__module__}.{function.__qualname__}"


def jit(function: F) -> F:
    """Compile `function` in nopython mode, with fast floating point; it releases the interpreter lock."""
    return _compiled(function, {})


def jit_dividing(function: F) -> F:
    """`jit`, but a division by zero gives inf or nan as in NumPy, and does not raise. Without this check
    the compiler can vectorise."""
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
                "kernels are compiled anew at each start, which takes up to two minutes: there is no "
                "writable folder to keep them in. Set NUMBA_CACHE_DIR to a writable folder"
            )
            print(text, file=sys.stderr, flush=True)
        NOT_KEPT.add(name_of(function))
        return cast(F, numba.njit(**options)(function))
    if not numba.config.DISABLE_JIT:  # otherwise `kernel` is the plain function
        kernel._cache._cache_file._source_stamp = kernel_sources()
        _ignore_failures(kernel._cache)
    return cast(F, kernel)


def _ignore_failures(kept: Any) -> None:
    """Compile again if a cache cannot be read: an older version of the package wrote it, or a power cut left
    it incomplete. If it cannot be written, as on a full disk, go on without it."""

    def or_emptied(use: Callable[..., Any], how: int) -> Callable[..., Any]:
        def used(*arguments: Any) -> Any:
            with suppress(OSError), _locked(kept.cache_path, how):  # OSError: no descriptor is left for it
                try:
                    return use(*arguments)
                except Exception as error:  # damaged data raise any kind
                    # Without the index no data are read: after a failed write they may be of older sources.
                    # That this process lacks descriptors or memory to read them says nothing about them.
                    if how == fcntl.LOCK_EX or not isinstance(error, OSError | MemoryError):
                        Path(kept._cache_file._index_path).unlink()
            return None

        return used

    kept.load_overload = or_emptied(kept.load_overload, fcntl.LOCK_SH)
    kept.save_overload = or_emptied(kept.save_overload, fcntl.LOCK_EX)


@contextmanager
def _locked(folder: str, how: int) -> Iterator[None]:
    """Lock a folder of cached kernels. Numba replaces the index, and then the data that it names: between the
    two, another process would find data of older sources, or would give its own data the same name."""
    place = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(place, how)
        yield
    finally:
        os.close(place)


@cache
def kernel_sources() -> str:
    """A digest of all source files of the package with kernels."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        text = path.read_bytes()
        if b"support.jit import" in text:
            digest.update(text)
    return digest.hexdigest()
