"""If perception is slower than its deadline, the loop waits for it and uses its answers."""

from __future__ import annotations

import pytest

from huepose.reinit import ReinitLoop
from huepose.tracking.types import Verdict

from .conftest import MS, estimate, pose, result

TAKES_MS = 2500


def test_slow_perception_is_not_asked_again_before_it_can_have_answered() -> None:
    loop, requests, work = ReinitLoop(objects=[("mug", 1)]), [], None
    for ms in range(0, 30_000, 50):
        request = loop.tick(ms * MS, [])
        if request is not None:
            requests.append(ms)
            # Like a worker with a ring of one: when it is free, it takes the newest request.
            waiting = (request, ms)
            if work is None:
                work = (*waiting, ms + TAKES_MS)
        if work is not None and ms >= work[2]:
            loop.answer(ms * MS, result(work[0], work[1]))
            work = (*waiting, ms + TAKES_MS) if waiting[1] > work[1] else None
    assert requests[:3] == [0, 600, 1200], "the configured deadline, until the time of an answer is known"
    late = [ms for ms in requests if ms > 10_000]
    assert len(late) == pytest.approx(20_000 / TAKES_MS, abs=1), "one request per answer"
    assert loop.answer_age_s == pytest.approx(2.5, abs=0.1)


def test_after_a_missed_deadline_the_configured_one_holds_again() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    first = loop.tick(0, [])
    assert first is not None
    loop.answer(2500 * MS, result(first, 0))
    second = loop.tick(2600 * MS, [])
    assert second is not None
    assert second.deadline_ns == (2600 + 1.5 * 2500) * MS
    third = loop.tick(second.deadline_ns, [])
    assert third is not None
    assert third.deadline_ns - second.deadline_ns == 600 * MS


def test_two_doubtful_sightings_that_are_seconds_apart_agree() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    for number, (x, verdicts) in enumerate([(0.0, []), (0.9, []), (0.02, [Verdict.ACQUIRE])]):
        now_ms = number * 2600
        request = loop.tick(now_ms * MS, [])
        assert request is not None
        found = loop.answer((now_ms + 2500) * MS, result(request, now_ms, estimate(T=pose(x), quality=0.6)))
        assert [c.verdict for c in found] == verdicts, "only sightings in one position agree"


def test_a_first_sighting_is_forgotten_if_answers_come_in_time() -> None:
    loop = ReinitLoop(objects=[("mug", 1)])
    for now_ms in (0, 1300):
        request = loop.tick(now_ms * MS, [])
        assert request is not None
        assert loop.answer((now_ms + 100) * MS, result(request, now_ms, estimate(quality=0.6))) == []
