"""What is derived from a file, made once: kept in the cache folder and mapped by every process that needs it.

The processes of a machine share what they read of it, and what nobody looks at takes no memory. It is made
anew for another file, and by another version of this package or of the libraries that compute it.

What is made once for each object in memory (`once_for_each`) is kept as long as that object lives.
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
"""What nobody has asked for as long is removed."""

VERSIONS = 2
"""So many versions of one file's are left: the running one's and the one before."""

ALIGNMENT = 64
"""Bytes: of each array's first element; NumPy aligns the data within its own files to as many."""


def kept(kind: type[T], digest: str | None, make: Callable[[], T]) -> T:
    """A dataclass of arrays, numbers and such dataclasses, as `make` gives it for the file of that digest;
    what is written to its arrays, this process alone sees. Made and not kept where there is no digest, or no
    folder that can be written."""
    if digest is None:
        return make()
    try:
        home = cache_folder() / "derived" / digest
    except InputError:
        return make()
    path = home / code_version() / f"{kind.__module__}.{kind.__qualname__}"
    try:
        if (found := _mapped(path)) is not None:
            return _assembled(kind, found)
        path.parent.mkdir(parents=True, exist_ok=True)
        with _alone(path):
            if _mapped(path) is None:
                _write(path, make())
                _tidy(home)
        found = _mapped(path)
    except OSError:
        found = None
    return make() if found is None else _assembled(kind, found)


@cache
def code_version() -> str:
    """A digest of the package's source and weights, and of the libraries' versions."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*")):
        if path.suffix in (".py", ".json", ".onnx"):
            digest.update(path.read_bytes())
    digest.update(f"{numpy_version} {cv2_version} {version('numba')}".encode())
    return digest.hexdigest()[:16]


def _parts(value: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """The arrays and numbers of a dataclass by name, those of one within it by both names."""
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
    """The file appears whole or not at all, a power cut included: kernels trust what is in it."""
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
    """The arrays of a file; None where there is none, or not a whole one."""
    try:
        with path.open("rb") as file:
            # A private mapping: what a process writes to its arrays, it alone sees.
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
def _alone(path: Path) -> Iterator[None]:
    """Of several processes one makes it, and the others wait for it. What it is made of may be kept as well:
    each has a lock of its own."""
    with path.with_name(f".{path.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _tidy(home: Path) -> None:
    """Remove what other versions of the code made of a file, but the newest, and what belongs to files that
    nobody asks for. Whoever has it mapped keeps it."""
    by_use = sorted(home.iterdir(), key=lambda one: one.stat().st_mtime, reverse=True)
    for folder in (*by_use[VERSIONS:], *unused(home.parent.iterdir(), UNUSED_DAYS)):
        shutil.rmtree(folder, ignore_errors=True)


def unused(places: Iterable[Path], days: float) -> list[Path]:
    """Those of some files and folders that nobody has asked for in so many days: whoever asks for a file, or
    for anything in a folder, sets its time."""
    long_ago = time.time() - days * 86400.0
    return [place for place in places if _last_asked(place) < long_ago]


def _last_asked(place: Path) -> float:
    """Seconds of the wall clock; of an empty folder, which somebody is about to fill, infinity."""
    try:
        asked = [one.stat().st_mtime for one in (place.iterdir() if place.is_dir() else (place,))]
    except FileNotFoundError:  # another process removes it
        return np.inf
    return max(asked, default=np.inf)


K = TypeVar("K")
V = TypeVar("V")


def once_for_each(make: Callable[[K], V]) -> Callable[[K], V]:
    """`make`, called once for each object: the result is kept until the object is gone, and threads that ask
    meanwhile wait for it.

    >>> class Mesh: ...
    >>> of, mesh = once_for_each(lambda mesh: object()), Mesh()
    >>> of(mesh) is of(mesh), of(mesh) is of(Mesh())
    (True, False)
    """
    results: WeakKeyDictionary[K, V] = WeakKeyDictionary()
    lock = threading.Lock()

    @wraps(make)
    def once(key: K) -> V:
        with lock:
            found = results.get(key)
            if found is None:
                found = results[key] = make(key)
            return found

    return once
