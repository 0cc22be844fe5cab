"""No stage of the library needs more CPU time than before, and a slower stage is reported."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from benchmarks.speed import CALLS, busier
from huepose_services.runtime.threads import THREAD_VARIABLES


def _speed(*arguments: str) -> tuple[int, dict[str, dict[str, float]]]:
    """Exit status and findings. Numeric libraries run on one thread, because their idle threads spin."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.speed", *arguments],
        env=os.environ | dict.fromkeys(THREAD_VARIABLES, "1"),
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
    )
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


@pytest.mark.live
@pytest.mark.pipeline
@pytest.mark.timeout(320)
def test_no_stage_became_slower():
    code, found = _speed()
    assert (code, found["slower"], found["busier"]) == (0, {}, {}), found


@pytest.mark.live
@pytest.mark.pipeline
@pytest.mark.timeout(320)
def test_a_stage_that_is_slower_by_half_is_reported():
    code, found = _speed("--only", "track", "--slowed", "0.5")
    assert (code, list(found["slower"])) == (1, ["track"]), found


def test_a_stage_that_calls_a_quarter_more_functions_is_reported():
    calls = {name: n if name == "detect" else round(1.25 * n) for name, n in CALLS.items()}
    assert list(busier(calls)) == ["track", "estimate"]
