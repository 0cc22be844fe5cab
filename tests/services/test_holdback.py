"""The rate limit, with times that the test gives."""

import pytest

from huepose_services.gateway import Holdback

MS = 1_000_000


def test_a_fast_source_is_limited_to_the_rate_and_its_last_value_arrives():
    limit, sent = Holdback(20.0), []
    for ms in range(0, 1000):
        for _, value in limit.due(ms * MS):
            sent.append((ms, value))
        if ms % 10 == 0 and ms <= 905 and limit.offer("a", ms, ms * MS) is not None:
            sent.append((ms, ms))
    assert [ms for ms, _ in sent] == list(range(0, 951, 50))
    assert sent[-1][1] == 900, "the last value is sent, late"
    assert limit.held == 91 - len(sent)


def test_a_source_at_the_rate_is_not_limited_because_of_its_jitter():
    limit = Holdback(30.0)
    jitter = [0, 3, -3, 2, -4, 4, 0, -2]
    sent = 0
    for i in range(300):
        now = i * 1000 * MS // 30 + jitter[i % 8] * MS
        sent += len(limit.due(now))
        sent += limit.offer("a", i, now) is not None
    assert sent >= 290


def test_keys_do_not_share_a_limit_and_urgent_values_pass():
    limit = Holdback(1.0)
    assert limit.offer("a", 1, 0) == 1
    assert limit.offer("b", 1, 0) == 1
    assert limit.offer("a", 2, MS) is None
    assert limit.next_ns() == 1000 * MS
    assert limit.offer("a", 3, 2 * MS, urgent=True) == 3
    assert limit.next_ns() is None, "what was held before is older than what was sent"


@pytest.mark.parametrize("silence_ms", [1000, 100_000])
def test_after_a_silence_there_is_no_burst(silence_ms):
    limit = Holdback(10.0)
    limit.offer("a", 0, 0)
    start = silence_ms * MS
    sent = [limit.offer("a", i, start + i * MS) is not None for i in range(50)]
    assert sum(sent) == 1
