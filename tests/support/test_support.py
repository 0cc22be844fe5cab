import io
import time

import numpy as np
import pytest
from numba.core import event

from huepose.support import progress as progress_module
from huepose.support.compiling import CompilingNotice
from huepose.support.errors import InputError
from huepose.support.jit import jit
from huepose.support.progress import progress


def test_error_says_what_was_found_and_what_to_do():
    error = InputError("a.obj", found="no faces", expected="a triangle mesh", fix="Export it again.")
    assert str(error) == "a.obj: found no faces; expected a triangle mesh. Export it again."


@pytest.fixture
def clock(monkeypatch):
    """The time of what is said, moved on by `clock[0] += seconds`."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_progress_yields_everything_and_stays_short_without_a_terminal():
    out = io.StringIO()
    assert list(progress(range(5), "views", out=out)) == [0, 1, 2, 3, 4]
    assert len(out.getvalue().splitlines()) == 2
    assert "5 of 5" in out.getvalue()


def test_a_log_says_soon_how_long_it_takes_and_then_every_ten_seconds(clock):
    out = io.StringIO()
    for _ in progress(range(30), "views", out=out):
        clock[0] += 1.0
    assert out.getvalue().splitlines() == [
        "views: 0 of 30",
        "views: 2 of 30, 2 s, 28 s left",
        "views: 12 of 30, 12 s, 18 s left",
        "views: 22 of 30, 22 s, 8 s left",
        "views: 30 of 30 in 30.0 s",
    ]


def test_a_step_that_takes_long_is_not_silent(monkeypatch):
    monkeypatch.setattr(progress_module, "_FIRST_LINE_S", 0.05)
    monkeypatch.setattr(progress_module, "_LOOK_EVERY_S", 0.01)
    out = io.StringIO()
    steps = progress(range(2), "views", out=out)
    next(steps)
    until = time.monotonic() + 20.0
    while "views: 0 of 2, 0 s\n" not in out.getvalue():
        assert time.monotonic() < until
        time.sleep(0.01)
    steps.close()
    assert out.getvalue().splitlines() == ["views: 0 of 2", "views: 0 of 2, 0 s"]


def test_the_time_left_leaves_out_the_first_step_which_may_have_compiled(clock):
    out = io.StringIO()
    for i in progress(range(40), "views", out=out):
        clock[0] += 60.0 if i == 0 else 1.0
    assert "views: 1 of 40, 60 s\n" in out.getvalue()
    assert "views: 11 of 40, 70 s, 29 s left\n" in out.getvalue()


def test_compiling_is_told_once_and_then_how_far_it_is(clock):
    said = []
    notice = CompilingNotice(said.append)
    for _ in range(30):
        notice.notify(event.Event("numba:compile", event.EventStatus.START))
        clock[0] += 1.0
        notice.notify(event.Event("numba:compile", event.EventStatus.END))
    first, *rest = said
    assert first.startswith("compiling kernels for this computer, once")
    assert rest == [f"{n} kernels compiled, {n} s" for n in (2, 12, 22)]


def test_progress_is_shown_before_the_first_step_is_done():
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    out = Terminal()
    steps = progress(range(2), "views", out=out)
    next(steps)
    assert "views [" in out.getvalue()
    assert "0/2" in out.getvalue()
    assert "left" not in out.getvalue()
    assert list(steps) == [1]


def test_kernels_keep_nan():
    @jit
    def first_nan(x):
        for i in range(len(x)):
            if np.isnan(x[i]):
                return i
        return -1

    assert first_nan(np.array([1.0, np.nan])) == 1
