"""How a worker's process ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

CLOSED = """
import sys
from pathlib import Path
from huepose_services.runtime import worker
from huepose_services.runtime.config_file import parse_all
from huepose_services.runtime.work import Work


class Broken(Work):
    def due_ns(self):
        return 0

    def step(self):
        {step}

    def close(self):
        print("let go")
        {close}


worker._made = lambda *_: Broken()
path = Path("pipeline.yaml")
sys.exit(worker.run_worker("camera", parse_all("workers: [camera]", path)[0], path, None))
"""


@pytest.mark.parametrize(
    ("step", "close", "code"),
    [
        ("raise ValueError('in its work')", "pass", 1),
        ("raise ValueError('in its work')", "raise KeyError('in closing')", 1),
        ("self.finished = True", "raise KeyError('in closing')", 0),
    ],
)
def test_the_camera_is_closed_however_its_work_ends(tmp_path: Path, step: str, close: str, code: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLOSED.format(step=step, close=close)],
        capture_output=True,
        text=True,
        env={**os.environ, "HUEPOSE_RUN": str(tmp_path)},
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (code, "let go\n"), done.stderr
    assert ("ValueError: in its work" in done.stderr.splitlines()[-1]) == (code == 1)
    assert ("error in closing" in done.stderr) == ("KeyError" in close)


@pytest.mark.parametrize(
    ("step", "said", "tracebacks"),
    [
        (
            "from huepose.support.errors import InputError; raise InputError('0.png', found='nothing')",
            "error in its work, going on: 0.png: found nothing.",
            0,
        ),
        ("raise ValueError('in its work')", "error in its work, going on:", 1),
    ],
)
def test_only_unexpected_errors_have_a_traceback_in_the_log(
    tmp_path: Path, step: str, said: str, tracebacks: int
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLOSED.format(step=step, close="pass")],
        capture_output=True,
        text=True,
        env={**os.environ, "HUEPOSE_RUN": str(tmp_path)},
        timeout=60,
    )
    log = [line for line in done.stderr.splitlines() if " error camera " in line]
    assert log[0].endswith(said)
    assert sum("Traceback" in line for line in log) == tracebacks
