"""A benchmark: libraries use one thread; the chart has a row for each part that has stages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2

from huepose_services.cli.bench import draw_stages
from huepose_services.runtime.threads import THREAD_VARIABLES


def test_each_part_that_has_stages_gets_a_row(tmp_path: Path) -> None:
    tracking = [("track", 9.0, 20.0), ("track/follow", 8.0, 19.0), ("segment", 3.0, 4.0)]
    finding = [("detect", 50.0, 60.0), ("detect/look", 8.0, 9.0), ("detect two", 26.0, 40.0)]
    draw_stages(tmp_path / "a.png", [*tracking, *finding])
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture is not None
    assert picture.shape[0] == 2 * 320
    draw_stages(tmp_path / "b.png", [("segment", 3.0, 4.0)])
    assert not (tmp_path / "b.png").exists()


ONE_THREAD = """
import os
from huepose_services.cli import bench
from huepose_services.cli.main import main

begin = bench.single_threaded

def begin_a_short_one():
    begin()
    from huepose_services import bus_bench
    bus_bench.bench_bus.__defaults__ = (0.5,)  # seconds

bench.single_threaded = begin_a_short_one
assert main(["bench", "bus", "--json"]) == 0
import cv2
from huepose_services.runtime.threads import THREAD_VARIABLES
print(cv2.getNumThreads(), *(os.environ[name] for name in THREAD_VARIABLES))
"""


def test_libraries_have_one_thread_as_in_the_workers() -> None:
    free = {name: value for name, value in os.environ.items() if name not in THREAD_VARIABLES}
    command = [sys.executable, "-c", ONE_THREAD]
    done = subprocess.run(command, env=free, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "1 1 1 1 1"
