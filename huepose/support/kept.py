"""Data that are derived from a file: computed once, kept in the cache folder, and mapped into every process
that needs them.

The processes of a machine share the memory of what they read, and what no process reads takes no memory.
The data are computed again for another file, and by another version of this package or of the libraries
that it uses.

`once_for_each` caches in memory: one result for each object, kept as long as the object exists.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import mmap
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from functools import cache, wraps
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints
from weakref import WeakKeyDictionary

import numpy as np
from cv2 import __version__ as cv2_version
from numpy import __version__ as numpy_version

from huepose.support.errors import InputError
from huepose.support.files import cache_folder, whole

T = TypeVar("T")

UNUSED_DAYS = 30
"""Cached data that no process has read for so many days are removed."""

VERSIONS = 2
"""Versions of the code whose data are kept for one file: the running one and the one before."""

ALIGNMENT = 64
"""Alignment of each array's first element, bytes; NumPy's own files have the same."""


def kept(kind: type[T], digest: str | None, make: Callable[[], T]) -> T:
    """What `make` derives from the file of that digest: a dataclass of arrays, numbers and such dataclasses.
    Changes to its arrays are visible only to this process. Without a digest or a writable cache folder it is
    made but not kept."""
    if digest is None:
        return make()
    try:
        home = cache_folder() / "derived" / digest
    except InputError:
        return make()
    path, made = home / code_version() / f"{kind.__module__}.{kind.__qualname__}", None
    try:
        if (found := _mapped(path)) is not None:
            return _assembled(kind, found)
        path.parent.mkdir(parents=True, exist_ok=True)
        with _locked(path):
            if _mapped(path) is None:
                made = make()
                _write(path, made)
                _tidy(path.parent)
        found = _mapped(path)
    except OSError:
        found = None
    if found is not None:
        return _assembled(kind, found)
    return make() if made is None else made


@cache
def code_version() -> str:
    """A digest of the package's source and weights, and of the versions of the libraries."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*")):
        if path.suffix in (".py", ".json", ".onnx"):
            digest.update(path.read_bytes())
    digest.update(f"{numpy_version} {cv2_version} {version('numba')}".encode())
    return digest.hexdigest()[:16]


def _parts(value: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """The arrays and numbers of a dataclass by name; those of a nested dataclass as `.outer.inner`."""
    if is_dataclass(value):
        for field in fields(value):
            yield from _parts(getattr(value, field.name), f"{name}.{field.name}")
    else:
        yield name, np.ascontiguousarray(value).reshape(np.shape(value))


def _assembled(kind: type[T], parts: dict[str, np.ndarray], name: str = "") -> T:
    if not is_dataclass(kind):
        return cast(T, parts[name] if parts[name].ndim else parts[name].item())
    hints = get_type_hints(kind)
    within = {f.name: _assembled(hints[f.name], parts, f"{name}.{f.name}") for f in fields(kind)}
    return cast(T, kind(**within))


def _write(path: Path, value: Any) -> None:
    """Write the file completely or not at all, even in a power cut: kernels do not check its content."""
    parts = dict(_parts(value))
    end, where = 0, {}
    for name, array in parts.items():
        where[name] = (array.dtype.str, array.shape, end)
        end += -(-array.nbytes // ALIGNMENT) * ALIGNMENT
    header = json.dumps({"bytes": end, "arrays": where}).encode()
    first = -(-(8 + len(header)) // ALIGNMENT) * ALIGNMENT
    with whole(path) as part, part.open("wb") as file:
        file.write(len(header).to_bytes(8, "little") + header)
        for name, array in parts.items():
            file.seek(first + where[name][2])
            file.write(array.data if array.size else b"")
        file.truncate(first + end)
        file.flush()
        os.fsync(file.fileno())


def _mapped(path: Path) -> dict[str, np.ndarray] | None:
    """The arrays of a file; None if there is no file, or not a complete one."""
    try:
        with path.open("rb") as file:
            # A private mapping: what a process writes to its arrays is visible only to itself.
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    except (FileNotFoundError, ValueError):
        return None
    length = int.from_bytes(content[:8], "little")
    first = -(-(8 + length) // ALIGNMENT) * ALIGNMENT
    if len(content) < first:
        return None
    try:
        header = json.loads(content[8 : 8 + length])
        if len(content) != first + header["bytes"]:
            return None
        arrays = {
            name: np.ndarray(shape, dtype, content, first + offset)
            for name, (dtype, shape, offset) in header["arrays"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError):  # the header is damaged
        return None
    with suppress(OSError):
        os.utime(path.parent)
    return arrays


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One of several processes makes the file, and the others wait. Each file has its own lock, because
    making it may need other cached files."""
    with path.with_name(f".{path.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _tidy(mine: Path) -> None:
    """Remove a file's data of older versions of the code, except the VERSIONS last used, and the data of
    files that are not used any more. mine: the data of the running version, which stay even if the clock was
    set back. A process that has them mapped keeps them."""
    home = mine.parent
    others = (one for one in home.iterdir() if one != mine)
    by_use = sorted(others, key=lambda one: one.stat().st_mtime, reverse=True)
    for folder in (*by_use[VERSIONS - 1 :], *unused(home.parent.iterdir(), UNUSED_DAYS)):
        shutil.rmtree(folder, ignore_errors=True)


def unused(places: Iterable[Path], days: float) -> list[Path]:
    """The files and folders that no process has used for so many days. Each use sets the modification time
    of the file, or of something in the folder."""
    long_ago = time.time() - days * 86400.0
    return [place for place in places if _last_asked(place) < long_ago]


def _last_asked(place: Path) -> float:
    """Time of the last use, seconds of the wall clock; infinity for an empty folder, which is about to be
    filled."""
    try:
        asked = [one.stat().st_mtime for one in (place.iterdir() if place.is_dir() else (place,))]
    except FileNotFoundError:  # another process removes it
        return np.inf
    return max(asked, default=np.inf)


K = TypeVar("K")
V = TypeVar("V")


def once_for_each(make: Callable[[K], V]) -> Callable[[K], V]:
    """`make`, called once for each object. The result is kept as long as the object exists; other threads
    that ask for it meanwhile wait.

    >>> class Mesh: ...
    >>> of, mesh = once_for_each(lambda mesh: object()), Mesh()
    >>> of(mesh) is of(mesh), of(mesh) is of(Mesh())
    (True, False)
    """
    results: WeakKeyDictionary[K, V] = WeakKeyDictionary()
    lock = threading.Lock()

    @wraps(make)
    def once(key: K) -> V:
        found = results.get(key)  # what is there does not wait for what another thread makes
        if found is None:
            with lock:
                found = results.get(key)
                if found is None:
                    found = results[key] = make(key)
        return found

    return once
