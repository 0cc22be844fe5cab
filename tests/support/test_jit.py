"""A cached kernel is reused, and compiled again when the source of any kernel has changed."""

from __future__ import annotations

import errno
import importlib
import importlib.metadata
import importlib.util
import os
import pickle
import select
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba.core.caching import IndexDataCacheFile

from huepose.support import jit

KERNEL = """
from huepose.support.jit import jit

@jit
def doubled(x: float) -> float:
    return 2.0 * x
"""


def compiled(path: Path) -> Any:
    """The kernel of the file as a new process would see it, called once."""
    spec = importlib.util.spec_from_file_location("kernels_of_a_test", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.doubled(3.0) == 6.0
    return module.doubled.stats


def test_a_kernel_is_compiled_again_when_another_source_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "kernels.py"
    path.write_text(KERNEL)
    assert not compiled(path).cache_hits
    assert sum(compiled(path).cache_hits.values()) == 1
    monkeypatch.setattr(jit, "kernel_sources", lambda: "of another version")
    assert not compiled(path).cache_hits


def test_a_cache_that_names_a_missing_class_is_made_again(tmp_path: Path) -> None:
    """As an earlier version of the package left it, whose modules had other names."""
    path = tmp_path / "kernels.py"
    path.write_text(KERNEL)
    compiled(path)
    (index,) = (tmp_path / "__pycache__").glob("*.nbi")
    version = pickle.dumps(importlib.metadata.version("numba"))
    foreign = b"\x80\x04\x8c\x0bno.such.one\x8c\x05Thing\x93."  # a class of a module that is not there
    index.write_bytes(version + foreign)
    assert not compiled(path).cache_hits
    assert sum(compiled(path).cache_hits.values()) == 1


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_file_that_a_power_cut_left_incomplete_is_made_again(
    tmp_path: Path, ending: str, share: float
) -> None:
    path = tmp_path / "kernels.py"
    path.write_text(KERNEL)
    compiled(path)
    (file,) = (tmp_path / "__pycache__").glob(f"*.{ending}")
    os.truncate(file, int(share * file.stat().st_size))
    assert not compiled(path).cache_hits
    assert sum(compiled(path).cache_hits.values()) == 1


def test_on_a_full_disk_a_kernel_works_and_code_of_older_sources_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "kernels.py"
    # Of another length: Python knows a changed file by its second of change and its length.
    path.write_text(KERNEL.replace("2.0 * x", "x + 1.00"))
    with pytest.raises(AssertionError):
        compiled(path)

    def full(kept: Any, name: str, data: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path.write_text(KERNEL)
    monkeypatch.setattr(jit, "kernel_sources", lambda: "of the new sources")
    with monkeypatch.context() as patch:
        patch.setattr(IndexDataCacheFile, "_save_data", full)
        assert not compiled(path).cache_hits
    assert not compiled(path).cache_hits
    assert sum(compiled(path).cache_hits.values()) == 1


def failing(error: Exception) -> Any:
    """A function that raises this error."""

    def fail(*arguments: Any) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("place", "name", "error"),
    [
        (jit, "_locked", OSError(errno.EMFILE, "Too many open files")),
        (IndexDataCacheFile, "load", OSError(errno.EMFILE, "Too many open files")),
        (IndexDataCacheFile, "load", MemoryError()),
    ],
)
def test_a_process_that_cannot_read_a_kernel_leaves_it_to_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: Any, name: str, error: Exception
) -> None:
    path = tmp_path / "kernels.py"
    path.write_text(KERNEL)
    compiled(path)
    with monkeypatch.context() as patch:
        patch.setattr(IndexDataCacheFile, "save", lambda *_: None)
        patch.setattr(place, name, failing(error))
        assert not compiled(path).cache_hits
    assert sum(compiled(path).cache_hits.values()) == 1


OTHER_PROCESS = """
import numba
from huepose.support import jit
numba.njit(lambda x: x)(1.0)  # from now on it loads a kernel at once
jit.kernel_sources = lambda: "of the new sources"
import kernels_of_a_test
print("ready", flush=True)
input()
print(kernels_of_a_test.doubled(3.0), flush=True)
"""


def test_a_process_that_loads_a_kernel_while_another_saves_it_gets_no_code_of_older_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def doubled(source: str) -> float:
        (tmp_path / "kernels_of_a_test.py").write_text(source)
        monkeypatch.delitem(sys.modules, "kernels_of_a_test", raising=False)
        return float(importlib.import_module("kernels_of_a_test").doubled(3.0))

    monkeypatch.syspath_prepend(tmp_path)
    assert doubled(KERNEL.replace("2.0 * x", "x + 1.00")) == 4.0
    monkeypatch.setattr(jit, "kernel_sources", lambda: "of the new sources")
    (tmp_path / "kernels_of_a_test.py").write_text(KERNEL)
    command, save_index = [sys.executable, "-c", OTHER_PROCESS], IndexDataCacheFile._save_index
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path
    ) as other:
        assert other.stdin is not None
        assert other.stdout is not None
        assert other.stdout.readline() == "ready\n"

        def let_the_other_load(kept: Any, overloads: Any) -> None:
            save_index(kept, overloads)
            other.stdin.write("\n")
            other.stdin.flush()
            select.select([other.stdout], [], [], 3.0)  # it waits until the data are there, too

        monkeypatch.setattr(IndexDataCacheFile, "_save_index", let_the_other_load)
        assert doubled(KERNEL) == 6.0
        assert other.stdout.readline() == "6.0\n"


def test_if_no_kernel_can_be_cached_one_line_says_what_to_do(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba caches nothing of source that is no file, as if no folder could be written."""
    monkeypatch.setattr(jit, "NOT_KEPT", set())
    for name in ("one", "another"):
        scope: dict[str, Any] = {"__name__": "kernels_of_a_test"}
        exec(compile(KERNEL, f"<{name}>", "exec"), scope)
        assert scope["doubled"](3.0) == 6.0
    (said,) = capfd.readouterr().err.splitlines()
    assert said.startswith("kernels are compiled anew at each start")
    assert "Set NUMBA_CACHE_DIR" in said
    assert {"kernels_of_a_test.doubled"} == jit.NOT_KEPT


def test_the_digest_is_of_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    package = Path(jit.__file__).parents[1]
    read = Path.read_bytes

    def changed(path: Path) -> bytes:
        text = read(path)
        return text + b"#" if path == package / "judge" / "kernel.py" else text

    before = jit.kernel_sources.__wrapped__()
    assert jit.kernel_sources.__wrapped__() == before
    monkeypatch.setattr(Path, "read_bytes", changed)
    assert jit.kernel_sources.__wrapped__() != before
