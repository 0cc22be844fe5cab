"""The file of a loop is read back as written; a damaged file is not opened."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.scenes.loop_file import UNUSED_DAYS, kept_loop, open_loop, write_loop
from huepose.support.errors import InputError
from huepose.support.files import cache_folder


def frames(n: int = 5) -> list:
    rng = np.random.default_rng(0)
    pictures = []
    for k in range(n):
        color = cv2.GaussianBlur(rng.integers(0, 256, (60, 80, 3), dtype=np.uint8), (0, 0), 4)
        depth = rng.uniform(0.3, 7.0, (60, 80)).astype(np.float32)
        depth[:3] = 0
        pictures.append((color, depth, {"number": k}))
    return pictures


def test_round_trip(tmp_path: Path) -> None:
    path, made = tmp_path / "sub" / "a.loop", frames()
    write_loop(path, made)
    opened = open_loop(path)
    assert opened is not None
    loop, rows = opened
    assert rows == [{"number": k} for k in range(5)]
    assert len(loop) == 5
    for k, (color, depth, _) in enumerate(made):
        seen = loop.depth(k)
        near, far = depth < 6.553, depth > 6.554
        np.testing.assert_allclose(seen[near], depth[near], atol=0.000051)
        assert not seen[far].any()
        assert seen.dtype == np.float32
        assert np.abs(loop.color(k).astype(int) - color).mean() < 2.0
    assert [p.name for p in path.parent.iterdir()] == ["a.loop"]


@pytest.mark.parametrize(
    "damage", ["flip a bit of a picture", "flip a bit of the index", "cut", "empty", "other"]
)
def test_a_damaged_file_is_not_opened(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.loop"
    write_loop(path, frames())
    data = bytearray(path.read_bytes())
    if damage == "flip a bit of a picture":
        data[1000] ^= 4
    elif damage == "flip a bit of the index":
        data[-60] ^= 1
    elif damage == "cut":
        del data[len(data) // 2 :]
    elif damage == "empty":
        data.clear()
    else:
        data = bytearray(b"something else altogether, longer than the tail of a loop")
    path.write_bytes(data)
    assert open_loop(path) is None


def test_a_failed_rendering_leaves_no_file(tmp_path: Path) -> None:
    def broken():
        yield frames()[0]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_loop(tmp_path / "a.loop", broken())
    assert not list(tmp_path.iterdir())
    assert open_loop(tmp_path / "a.loop") is None


def unused_for(path: Path, days: float) -> None:
    os.utime(path, (time.time() - days * 86400,) * 2)


def test_unused_loops_are_deleted_and_those_in_use_stay(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.loop" for name in ("old", "asked_for", "playing", "young")]
    for path in paths:
        write_loop(path, frames(1))
    (tmp_path / "notes.txt").write_text("not a loop")
    playing = open_loop(paths[2])
    for path in (*paths[:3], tmp_path / "notes.txt"):
        unused_for(path, UNUSED_DAYS + 1)
    unused_for(paths[3], UNUSED_DAYS - 1)
    kept_loop(paths[1], list)
    write_loop(tmp_path / "new.loop", frames(1))
    left = {p.name for p in tmp_path.iterdir()}
    assert left == {"asked_for.loop", "playing.loop", "young.loop", "new.loop", "notes.txt"}

    del playing
    unused_for(paths[2], UNUSED_DAYS + 1)
    write_loop(tmp_path / "new.loop", frames(1))
    assert not paths[2].exists()


_WRITES_ITS_FIRST_FRAME = """
import sys
from pathlib import Path
import numpy as np
from huepose.scenes.loop_file import write_loop

def drawn():
    yield np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8), np.float32), {}
    print("ready", flush=True)
    sys.stdin.read()

write_loop(Path(sys.argv[1]), drawn())
"""


def test_the_partial_file_of_a_killed_writer_is_deleted_that_of_a_running_one_stays(tmp_path: Path) -> None:
    call = [sys.executable, "-c", _WRITES_ITS_FIRST_FRAME, str(tmp_path / "slow.loop")]
    with subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"ready\n"
        write_loop(tmp_path / "other.loop", frames(1))
        assert len(list(tmp_path.glob(".slow.loop.*.part"))) == 1
        writer.kill()
    assert len(list(tmp_path.glob(".slow.loop.*.part"))) == 1
    write_loop(tmp_path / "other.loop", frames(1))
    assert [p.name for p in tmp_path.iterdir()] == ["other.loop"]


def test_the_error_for_an_unwritable_folder_names_xdg_cache_home(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="XDG_CACHE_HOME"):
        write_loop(tmp_path / "file" / "a.loop", frames())


def test_the_cache_folder_follows_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "huepose"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "huepose"
