"""The processors that a worker keeps to."""

from __future__ import annotations

import os
import subprocess
import sys

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


def test_a_worker_and_its_threads_keep_to_the_processors_that_are_named() -> None:
    processor = max(os.sched_getaffinity(0))
    said = subprocess.run(
        [sys.executable, "-c", KEPT.format(processor=processor)], capture_output=True, text=True, check=True
    )
    assert said.stdout.strip() == f"{{{processor}}} {{{processor}}}"


def test_a_processor_that_there_is_not_is_named() -> None:
    before = os.sched_getaffinity(0)
    with pytest.raises(InputError, match="found 1022; expected processors of this computer"):
        keep_to([1022])
    keep_to([])
    assert os.sched_getaffinity(0) == before
