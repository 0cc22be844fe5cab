"""Threads share work evenly, keep the order of answers, and raise errors."""

import subprocess
import sys
from threading import Barrier

import pytest

from huepose.support.pool import Pool, Steps, finished
from huepose.support.stages import listening, stage


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_answers_come_in_the_order_of_the_parts(threads: int) -> None:
    def work(part: int) -> Steps[int]:
        for _ in range(part):
            yield
        return 10 * part

    assert Pool(threads).map_steps(work, [3, 0, 2, 1]) == [30, 0, 20, 10]
    assert finished(work(2)) == 20


def test_three_parts_keep_two_threads_busy_to_the_end() -> None:
    both_busy = Barrier(2, timeout=10.0)

    def work(_: int) -> Steps[bool]:
        both_busy.wait()  # Passes only while the other thread works as well.
        yield
        both_busy.wait()
        return True

    assert Pool(2).map_steps(work, range(3)) == [True, True, True]


def test_an_error_in_a_late_step_is_raised() -> None:
    def work(part: int) -> Steps[int]:
        yield
        if part == 1:
            raise ValueError("part 1")
        return part

    with pytest.raises(ValueError, match="part 1"):
        Pool(2).map_steps(work, range(3))


def test_listeners_hear_the_stages_of_all_steps() -> None:
    def work(_: int) -> Steps[None]:
        with stage("before"):
            pass
        yield
        with stage("after"):
            pass

    with listening() as clock:
        Pool(2).map_steps(work, range(3))
    assert {name: len(spans) for name, spans in clock.spans.items()} == {"before": 3, "after": 3}


def test_a_program_ends_that_may_not_have_as_many_threads_as_it_wants() -> None:
    """As in a container with a limit of processes."""
    program = (
        "import threading\nfrom huepose.support.pool import Pool\n"
        "start = threading.Thread.start\n"
        "def refused(thread):\n"
        "    if threading.active_count() > 2: raise RuntimeError('no more')\n"
        "    start(thread)\n"
        "threading.Thread.start = refused\nPool(3)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60.0)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, "RuntimeError: no more")
