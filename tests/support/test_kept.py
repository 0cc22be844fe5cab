from __future__ import annotations

import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from huepose.support import kept as module
from huepose.support.errors import InputError
from huepose.support.files import cache_folder
from huepose.support.kept import code_version, kept, once_for_each
from tests.disk import full_disk


@dataclass(frozen=True, eq=False)
class Inner:
    turns: np.ndarray
    span_m: float


@dataclass(frozen=True, eq=False)
class Outer:
    inner: Inner
    places: np.ndarray
    none: np.ndarray
    side: int


class Maker:
    """Makes a value and counts how often."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> Outer:
        self.calls += 1
        turns = np.arange(24.0).reshape(2, 3, 4).transpose(0, 2, 1)
        return Outer(Inner(turns, 0.1), np.arange(5, dtype=np.uint16), np.zeros((0, 3), np.float32), 16)


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "huepose" / "derived"


def assert_same(one: Outer, other: Outer) -> None:
    pairs = [(one.inner.turns, other.inner.turns), (one.places, other.places), (one.none, other.none)]
    for x, y in pairs:
        assert (x.dtype, x.shape) == (y.dtype, y.shape)
        np.testing.assert_array_equal(x, y)
    assert (one.side, one.inner.span_m) == (other.side, other.inner.span_m)
    assert type(one.side) is int
    assert type(one.inner.span_m) is float


def test_a_value_is_made_once_and_comes_back_bit_for_bit() -> None:
    make = Maker()
    for _ in range(3):
        assert_same(kept(Outer, "tea", make), Maker()())
    assert make.calls == 1
    kept(Outer, "soup", make)
    assert make.calls == 2


def test_arrays_are_aligned_and_writing_to_them_stays_private() -> None:
    first = kept(Outer, "tea", Maker())
    assert first.places.ctypes.data % 64 == 0
    assert first.inner.turns.flags.c_contiguous
    assert first.places.flags.writeable
    first.places[:] = 9
    assert_same(kept(Outer, "tea", Maker()), Maker()())


def test_without_a_file_or_a_folder_a_value_is_made_and_not_kept(home: Path) -> None:
    make = Maker()
    for _ in range(2):
        assert_same(kept(Outer, None, make), Maker()())
    assert make.calls == 2
    assert not home.exists()
    home.parent.mkdir()
    home.write_text("no folder")
    assert_same(kept(Outer, "tea", make), Maker()())
    assert make.calls == 3


def test_on_a_full_disk_a_value_is_made_once_and_not_kept(home: Path) -> None:
    make = Maker()
    with full_disk():
        assert_same(kept(Outer, "tea", make), Maker()())
    assert make.calls == 1
    assert not [p for p in home.rglob("tests*") if p.is_file()]


def test_without_a_home_a_value_is_made_and_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(number: int) -> None:
        raise KeyError(number)

    for variable in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    assert_same(kept(Outer, "tea", Maker()), Maker()())
    with pytest.raises(InputError, match="Set HOME, or XDG_CACHE_HOME"):
        cache_folder()


@pytest.mark.parametrize("size", [0, 7, 40, 600])
def test_an_incomplete_file_is_made_again(home: Path, size: int) -> None:
    kept(Outer, "tea", Maker())
    (path,) = (p for p in home.rglob("tests*") if p.is_file())
    assert path.stat().st_size > 600
    os.truncate(path, size)
    make = Maker()
    for _ in range(2):
        assert_same(kept(Outer, "tea", make), Maker()())
    assert make.calls == 1


@pytest.mark.parametrize("damage", [b"\xff\xfe", b"[]", b'{"bytes": 1}'])
def test_a_file_with_a_damaged_header_is_made_again(home: Path, damage: bytes) -> None:
    kept(Outer, "tea", Maker())
    (path,) = (p for p in home.rglob("tests*") if p.is_file())
    whole = path.read_bytes()
    length = int.from_bytes(whole[:8], "little")
    path.write_bytes(whole[:8] + damage.ljust(length) + whole[8 + length :])
    make = Maker()
    for _ in range(2):
        assert_same(kept(Outer, "tea", make), Maker()())
    assert make.calls == 1


def test_another_version_of_the_code_makes_it_again_and_only_the_newest_are_left(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Maker()
    for number in range(3):
        monkeypatch.setattr(module, "code_version", lambda n=number: f"version{n}")
        kept(Outer, "tea", make)
    assert make.calls == 3
    assert sorted(p.name for p in (home / "tea").iterdir()) == ["version1", "version2"]


def test_what_was_just_made_is_kept_although_the_clock_was_set_back(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, ahead = Maker(), time.time() + 40 * 86400
    for number in range(3):
        monkeypatch.setattr(module, "code_version", lambda n=number: f"version{n}")
        kept(Outer, "tea", make)
        if number < 2:
            os.utime(home / "tea" / f"version{number}", (ahead, ahead + number))
    kept(Outer, "tea", make)
    assert make.calls == 3
    assert sorted(p.name for p in (home / "tea").iterdir()) == ["version1", "version2"]


def test_values_that_are_long_unused_are_removed(home: Path) -> None:
    kept(Outer, "soup", Maker())
    kept(Outer, "tea", Maker())
    then = time.time() - 40 * 86400
    os.utime(home / "soup" / code_version(), (then, then))
    kept(Outer, "milk", Maker())
    assert sorted(p.name for p in home.iterdir()) == ["milk", "tea"]


@pytest.mark.timeout(20)
def test_a_value_may_be_made_of_another_that_is_kept_for_the_same_file() -> None:
    def make() -> Outer:
        return Outer(
            kept(Inner, "tea", lambda: Maker()().inner),
            np.arange(5, dtype=np.uint16),
            np.zeros((0, 3), np.float32),
            16,
        )

    assert_same(kept(Outer, "tea", make), Maker()())


def test_several_threads_make_a_value_once() -> None:
    make = Maker()

    def slowly() -> Outer:
        time.sleep(0.2)
        return make()

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: kept(Outer, "tea", slowly), range(4)))
    for one in found:
        assert_same(one, Maker()())
    assert make.calls == 1


def test_what_is_there_does_not_wait_for_what_another_thread_makes() -> None:
    """A search does not wait for the views of an object that is added meanwhile."""
    there, added = Maker(), Maker()
    begun, may_end = threading.Event(), threading.Event()

    @once_for_each
    def name_of(maker: Maker) -> str:
        if maker is added:
            begun.set()
            assert may_end.wait(60.0)
        return "made"

    name_of(there)
    with ThreadPoolExecutor(2) as pool:
        made = pool.submit(name_of, added)
        assert begun.wait(60.0)
        try:
            assert pool.submit(name_of, there).result(10.0) == "made"
        finally:
            may_end.set()
        assert made.result(60.0) == "made"
