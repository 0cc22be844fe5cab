"""In a flooded log, lines that repeat are counted and summed up."""

from huepose_services.runtime.log import Repeats


def test_a_warning_every_three_seconds_for_thirteen_minutes_is_a_handful_of_lines():
    repeats, lines = Repeats(), []
    for k in range(230):
        line = repeats.offer("late", "late", 3.4 * k)
        lines += [] if line is None else [line]
        lines += [text for _, text in repeats.due(3.4 * k + 1.0)]
    assert len(lines) < 10
    assert lines[:2] == ["late", "late"]
    counted = len(lines) + sum(int(line.split("(")[1].split(" ")[0]) for line in lines[2:] if "more" in line)
    assert 230 - 90 <= counted <= 230, "all are counted, except those of the last five minutes"


def test_lines_that_were_held_back_are_reported_also_when_nothing_follows():
    repeats = Repeats()
    assert [repeats.offer("a", "bad bytes", t / 10) for t in range(5)] == ["bad bytes", *[None] * 4]
    assert repeats.due(0.9) == []
    assert repeats.due(1.1) == [("a", "bad bytes (4 more in 1 s)")]
    assert repeats.due(100.0) == []


def test_a_late_report_says_how_long_ago_it_was():
    """It may no longer be true."""
    repeats = Repeats()
    repeats.offer("a", "slow", 0.0)
    repeats.offer("a", "slow", 1.5)
    repeats.offer("a", "slower", 2.0)
    assert repeats.due(5.4) == []
    assert repeats.due(5.6) == [("a", "slower (1 more in 4 s, the last 4 s ago)")]


def test_a_line_that_comes_again_after_a_long_time_is_reported_at_once():
    repeats = Repeats()
    assert repeats.offer("a", "x", 0.0) == "x"
    assert repeats.offer("a", "x", 0.5) is None
    assert repeats.offer("b", "y", 0.6) == "y"
    assert repeats.offer("a", "x", 200.0) == "x"


def test_lines_that_all_differ_take_limited_memory():
    repeats = Repeats()
    for k in range(10_000):
        repeats.offer(f"line {k}", "text", 0.001 * k)
    assert len(repeats._kinds) <= 256
