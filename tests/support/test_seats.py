"""Jobs that take turns: results in order, no more at work than there are seats, all done together."""

from __future__ import annotations

import threading
from functools import partial

import pytest

from huepose.support.seats import in_turns, pass_on
from huepose.support.stages import listening, stage


def test_results_come_in_the_order_of_the_jobs() -> None:
    for seats in (1, 2, 8):
        assert in_turns([partial(int, k) for k in range(5)], seats) == [0, 1, 2, 3, 4]
    assert in_turns([], 2) == []


@pytest.mark.parametrize(("spell_s", "order"), [(0.0, [1, 2, 3] * 3), (1e9, [1] * 3 + [2] * 3 + [3] * 3)])
def test_who_waits_longest_comes_next_once_a_spell_is_over(spell_s: float, order: list[int]) -> None:
    steps: list[int] = []
    over = threading.Event()

    def hold() -> None:
        assert over.wait(30)  # has one of the two seats all the time

    def job(k: int) -> None:
        for _ in range(3):
            with stage("step"):
                steps.append(k)
        if len(steps) == 9:
            over.set()

    in_turns([hold, *(partial(job, k) for k in (1, 2, 3))], 2, spell_s)
    assert steps == order


def test_no_more_work_than_there_are_seats() -> None:
    lock, together = threading.Lock(), threading.Barrier(2)
    at_work, most = 0, 0

    def job(k: int) -> None:
        nonlocal at_work, most
        for step in range(20):
            with lock:
                at_work += 1
                most = max(most, at_work)
            if step == 0 and k < 2:
                together.wait(30)  # two do work at the same time
            with lock:
                at_work -= 1
            pass_on()

    in_turns([partial(job, k) for k in range(5)], 2, spell_s=0.0)
    assert most == 2


def test_an_exception_is_raised_and_its_seat_is_free_again() -> None:
    def fail() -> int:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        in_turns([fail, fail, partial(int, 1), partial(int, 2)], 2)


def test_stages_of_all_jobs_reach_the_listener() -> None:
    def job() -> None:
        with stage("work"):
            pass

    with listening() as clock:
        in_turns([job] * 4, 2)
    assert len(clock.spans["work"]) == 4


def test_nothing_happens_outside() -> None:
    pass_on()
