"""What killed workers have left is removed where the next pipeline starts; what may be in use is not."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from huepose_protos.local import endpoint
from huepose_services.runtime.run_folder import OLD_S
from huepose_services.runtime.running import Pipeline, noted

WORKER = """import os, sys, time, zenoh
config = zenoh.Config.from_json5(
    '{mode: "peer", scouting: {multicast: {enabled: false}}, listen: {endpoints: ["' + sys.argv[1] + '"]}}'
)
session = zenoh.open(config)
print("open", flush=True)
time.sleep(60)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    (tmp_path / "run").mkdir(mode=0o700)
    return tmp_path / "run"


@pytest.fixture
def worker(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that listens at port 18301, as workers do."""
    process = subprocess.Popen(
        [sys.executable, "-c", WORKER, endpoint(18301)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "open\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def _age(folder: Path, age_s: float = 2.0 * OLD_S) -> None:
    for path in folder.iterdir():
        os.utime(path, (time.time() - age_s,) * 2)


def _left(folder: Path, base_port: int = 18400) -> list[str]:
    """What is there once a pipeline has started."""
    with noted(Pipeline(base_port=base_port)):
        return sorted(path.name for path in folder.iterdir() if path.suffix != ".json")


def test_what_a_killed_worker_left_is_removed(folder: Path, worker: subprocess.Popen[str]) -> None:
    both = ["18301", "18301.lock"]
    _age(folder)
    assert _left(folder) == both, "it listens"
    worker.kill()
    worker.wait()
    _age(folder, 0.5 * OLD_S)
    assert _left(folder) == both, "it is young"
    _age(folder)
    assert _left(folder, base_port=18300) == both, "a worker of a pipeline that runs: it comes back"
    assert _left(folder) == []


def test_a_lock_alone_goes_and_what_is_no_lock_of_a_port_stays(folder: Path) -> None:
    for name in ("18301.lock", "18302", "notes.lock", "18303.txt"):
        (folder / name).touch(mode=0o600)
    (folder / "18304.lock").symlink_to(folder / "18302")
    _age(folder)
    assert _left(folder) == ["18302", "18303.txt", "18304.lock", "notes.lock"]


def test_a_lock_that_somebody_holds_stays_though_nobody_listens_yet(folder: Path) -> None:
    with (folder / "18301.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _age(folder)
        assert _left(folder) == ["18301.lock"]
    _age(folder)
    assert _left(folder) == []
