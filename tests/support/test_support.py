import io

import numpy as np

from huepose.support.errors import InputError
from huepose.support.jit import jit
from huepose.support.progress import progress


def test_error_says_what_was_found_and_what_to_do():
    error = InputError("a.obj", found="no faces", expected="a triangle mesh", fix="Export it again.")
    assert str(error) == "a.obj: found no faces; expected a triangle mesh. Export it again."


def test_progress_yields_everything_and_stays_short_without_a_terminal():
    out = io.StringIO()
    assert list(progress(range(5), "views", out=out)) == [0, 1, 2, 3, 4]
    assert len(out.getvalue().splitlines()) == 2
    assert "5 of 5" in out.getvalue()


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
