"""The processors on which a worker runs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from huepose.support.errors import InputError
from huepose_services.runtime.worker import keep_to

KEPT = """
import os, threading
from huepose_services.runtime.worker import keep_to
keep_to([{processor}])
seen = []
thread = threading.Thread(target=lambda: seen.append(os.sched_getaffinity(0)))
thread.start()
thread.join()
print(os.sched_getaffinity(0), *seen)
"""


def test_a_worker_and_its_threads_run_on_the_named_processors() -> None:
    processor = max(os.sched_getaffinity(0))
    said = subprocess.run(
        [sys.executable, "-c", KEPT.format(processor=processor)], capture_output=True, text=True, check=True
    )
    assert said.stdout.strip() == f"{{{processor}}} {{{processor}}}"


def test_a_perception_worker_lowers_the_priority_of_a_session_of_its_own() -> None:
    """If the kernel shares time among sessions, the niceness of the session counts."""
    if not Path("/proc/self/autogroup").exists():
        pytest.skip("this kernel does not share time among sessions")
    code = "from huepose_services.runtime.worker import come_first\n"
    code += "come_first('estimator'); print(open('/proc/self/autogroup').read())"
    said = {
        own: subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, start_new_session=own
        ).stdout.split()
        for own in (True, False)
    }
    expected = os.nice(0) + 3
    assert said[True][1:] == ["nice", str(expected)]
    # A session with other processes is not changed.
    assert said[False][1:] != ["nice", str(expected)]


def test_a_missing_processor_is_named() -> None:
    before = os.sched_getaffinity(0)
    with pytest.raises(InputError, match="found 1022; expected processors of this computer"):
        keep_to([1022])
    keep_to([])
    assert os.sched_getaffinity(0) == before
