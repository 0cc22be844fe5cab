import io
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core import event

from huepose.support import compiling
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
    """The clock of all messages; `clock[0] += seconds` advances it."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_progress_yields_everything_and_stays_short_without_a_terminal():
    out = io.StringIO()
    assert list(progress(range(5), "views", out=out)) == [0, 1, 2, 3, 4]
    assert len(out.getvalue().splitlines()) == 2
    assert "5 of 5" in out.getvalue()


def test_a_log_shows_the_time_left_after_ten_seconds_and_then_every_ten(clock):
    out = io.StringIO()
    for _ in progress(range(30), "views", out=out):
        clock[0] += 1.0
    assert out.getvalue().splitlines() == [
        "views: 0 of 30",
        "views: 2 of 30, 2 s",
        "views: 12 of 30, 12 s, 18 s left",
        "views: 22 of 30, 22 s, 8 s left",
        "views: 30 of 30 in 30.0 s",
    ]


def test_the_time_left_is_shown_after_a_fifth_of_the_steps(clock):
    out = io.StringIO()
    for _ in progress(range(10), "views", out=out):
        clock[0] += 1.0
    assert "views: 2 of 10, 2 s, 8 s left\n" in out.getvalue()


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


def test_zero_time_left_is_not_shown_while_a_step_takes_longer_than_those_before_it(clock, monkeypatch):
    monkeypatch.setattr(progress_module, "_LOOK_EVERY_S", 0.01)
    out = io.StringIO()
    steps = progress(range(8), "views", out=out)
    for _ in range(5):
        next(steps)
        clock[0] += 0.5
    next(steps)  # five are done in half a second each; the next one takes twenty seconds
    for text in ("views: 5 of 8, 12 s\n", "views: 5 of 8, 22 s\n"):
        clock[0] += 10.0
        until = time.perf_counter() + 20.0
        while text not in out.getvalue():
            assert time.perf_counter() < until, out.getvalue()
            time.sleep(0.01)
    steps.close()
    assert " 0 s left" not in out.getvalue()


def compiled(notice, clock, module, count):
    """Notify of `count` functions of a module that took a second each."""
    for n in range(count):
        data = {
            "dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__=module, __qualname__=f"k{n}"))
        }
        notice.notify(event.Event("numba:compile", event.EventStatus.START, data))
        clock[0] += 1.0
        notice.notify(event.Event("numba:compile", event.EventStatus.END, data))


@pytest.mark.parametrize(("every", "upto"), [(False, "up to "), (True, "")])
def test_compiling_is_announced_once_and_then_its_progress(clock, monkeypatch, every, upto):
    monkeypatch.setattr(compiling, "KERNELS", {f"ours.k{n}" for n in range(25)})
    said = []
    notice = CompilingNotice(said.append, every)
    compiled(notice, clock, "ours", 22)
    compiled(notice, clock, "numba", 5)  # what kernels call
    compiled(notice, clock, "ours", 3)  # for example for other types of arguments
    clock[0] += 100.0  # of other work
    notice.finish()
    first, *rest, last = said
    assert first.startswith("compiling kernels for this computer, once: some seconds")
    left = {2: "", 12: f", {upto}13 s left", 22: f", {upto}3 s left"}
    assert rest == [f"{n} of {upto}25 kernels compiled, {n} s{left[n]}" for n in left]
    assert last == "22 kernels compiled in 30 s"


def test_kernels_that_are_not_kept_are_not_said_to_be_compiled_once(clock, monkeypatch):
    monkeypatch.setattr(compiling, "NOT_KEPT", {"ours.k0"})
    said = []
    compiled(CompilingNotice(said.append), clock, "ours", 1)
    assert said[0].startswith("compiling kernels for this computer: some seconds")


def test_a_bar_and_the_count_of_kernels_do_not_overwrite_each_other(clock, monkeypatch):
    monkeypatch.setattr(compiling, "KERNELS", {f"ours.k{n}" for n in range(9)})
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    notice = CompilingNotice()
    for _ in progress(range(1), "views"):
        compiled(notice, clock, "ours", 5)
    assert "kernels compiled" not in terminal.getvalue()
    compiled(notice, clock, "ours", 6)
    assert "\r6 of up to 9 kernels compiled, 11 s, up to 6 s left" in terminal.getvalue()


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
