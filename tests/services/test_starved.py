"""How long a process waited for a processor, with real processes that share one."""

import os
import subprocess
import sys
import time

import pytest

from huepose_services.runtime.supervisor import Starved

BUSY = "print(flush=True)\nwhile True: pass"
ASLEEP = "import time\nprint(flush=True)\ntime.sleep(60)"


@pytest.fixture
def start():
    started = []

    def start(code, processor):
        started.append(subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE))
        os.sched_setaffinity(started[-1].pid, {processor})
        started[-1].stdout.readline()
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_a_process_that_shares_a_processor_waits_and_one_that_sleeps_does_not(start):
    processor = min(os.sched_getaffinity(0))
    asleep = start(ASLEEP, processor)
    busy = [start(BUSY, processor) for _ in range(4)]
    of_busy, of_sleeper = Starved(busy[0].pid), Starved(asleep.pid)
    began = time.monotonic()
    time.sleep(2.0)
    waited_s, slept_s = of_busy.since_last_s(), of_sleeper.since_last_s()
    took_s = time.monotonic() - began
    assert 0.5 * took_s < waited_s <= took_s + 0.1, "three others run at least half of the time"
    assert slept_s < 0.1 * took_s
    again_s = of_busy.since_last_s()
    assert again_s < 0.5 + time.monotonic() - began - took_s, "only the time since the last call counts"


def test_a_process_that_has_ended_does_not_wait(start):
    process = start("pass", min(os.sched_getaffinity(0)))
    starved = Starved(process.pid)
    process.wait()
    assert starved.since_last_s() == 0.0
