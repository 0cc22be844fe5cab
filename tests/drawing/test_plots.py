"""Plots: data land on the pixels that the axes say."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.drawing import plots
from huepose.drawing.canvas import COLOURS, Canvas, limits, ticks


def ink(picture: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    return np.asarray((picture == color).all(-1))


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 0.97, [0.0, 0.2, 0.4, 0.6, 0.8]),
        (-3.1, 3.1, [-2.0, 0.0, 2.0]),
        (0.0, 240.0, [0.0, 50.0, 100.0, 150.0, 200.0]),
        (0.00012, 0.00031, [0.00015, 0.0002, 0.00025, 0.0003]),
    ],
)
def test_ticks_are_round_and_inside(low: float, high: float, expected: list[float]) -> None:
    assert ticks(low, high) == pytest.approx(expected)


def test_limits_hold_the_data_and_survive_none() -> None:
    low, high = limits(np.array([1.0, np.nan, 3.0]))
    assert low < 1.0 < 3.0 < high
    assert limits(np.array([1.0, 3.0]), zero=True)[0] == 0.0
    assert limits(np.array([np.nan])) == (0.0, 1.0)
    low, high = limits(np.array([2.0, 2.0]))
    assert low < 2.0 < high


def test_dots_and_lines_land_where_the_axes_say() -> None:
    canvas = Canvas.empty((0.0, 10.0), (-1.0, 1.0))
    canvas.dots(np.array([2.5]), np.array([0.5]), COLOURS[0], 4)
    rows, columns = np.nonzero(ink(canvas.picture, COLOURS[0]))
    at = canvas.pixels(np.array([[2.5, 0.5]]))[0]
    assert columns.mean() == pytest.approx(at[0], abs=0.6)
    assert rows.mean() == pytest.approx(at[1], abs=0.6)
    canvas.line(np.array([0.0, 10.0]), np.array([-0.5, -0.5]), COLOURS[1])
    assert ink(canvas.picture, COLOURS[1])[round(canvas.pixels(np.array([[5.0, -0.5]]))[0, 1])].sum() > 500


def test_what_is_outside_the_frame_is_cut_off() -> None:
    canvas = Canvas.empty((0.0, 1.0), (0.0, 1.0))
    blank = canvas.picture.copy()
    canvas.line(np.array([-5.0, 5.0]), np.array([2.0, 9.0]), COLOURS[0])
    canvas.dots(np.array([3.0, np.nan]), np.array([0.5, 0.5]), COLOURS[0])
    assert np.array_equal(canvas.picture, blank)
    canvas.line(np.array([0.5, 0.5]), np.array([-1e9, 1e9]), COLOURS[0])
    changed = (canvas.picture != blank).any(-1)
    rows = np.flatnonzero(changed.any(1))
    low, high = canvas.pixels(np.array([[0, 1.0], [0, 0.0]]))[:, 1]
    assert rows.min() >= low - 1
    assert rows.max() <= high + 1


def test_line_is_broken_at_nan() -> None:
    x = np.arange(5.0)
    picture = plots.line_plot({"a": (x, np.array([1, 1, np.nan, 1, 1.0]))}, x_range=(0, 4), y_range=(0, 2))
    canvas = Canvas.empty((0, 4), (0, 2))
    row, middle = (round(v) for v in canvas.pixels(np.array([[2.0, 1.0]]))[0][::-1])
    marked = ink(picture, COLOURS[0])[row - 2 : row + 3].any(0)
    assert not marked[middle - 30 : middle + 30].any()
    assert marked.sum() > 200


def test_bar_chart_has_a_bar_per_series_and_group() -> None:
    picture = plots.bar_chart(["one", "two"], {"a": [50, 100], "b": [100, 25]}, y_range=(0, 120))
    first = ink(picture, COLOURS[0])
    heights = first.sum(0)[first.any(0)]
    assert heights.max() == pytest.approx(2 * np.median(heights[: len(heights) // 3]), rel=0.05)
    assert ink(picture, COLOURS[1]).any()


def test_reliability_bins_are_equal_in_count_and_lie_on_the_diagonal_for_an_honest_score() -> None:
    rng = np.random.default_rng(0)
    quality = rng.uniform(0, 1, 40_000)
    stated, true, count = plots.reliability_bins(quality, rng.random(40_000) < quality)
    assert (count == 4000).all()
    np.testing.assert_allclose(stated, np.arange(0.05, 1, 0.1), atol=0.01)
    assert np.abs(stated - true).max() < 0.03
    assert [len(part) for part in plots.reliability_bins(np.ones(3), np.ones(3, bool))] == [3, 3, 3]


def test_reliability_plot_marks_the_bins() -> None:
    picture = plots.reliability_plot(np.full(50, 0.25), np.arange(50) < 25, bins=1)
    at = Canvas.empty((0, 1), (0, 1), size=(520, 480)).pixels(np.array([[0.25, 0.5]]))[0]
    assert tuple(picture[round(at[1]), round(at[0])]) == COLOURS[0]


def test_every_plot_takes_nothing() -> None:
    empty = np.empty(0)
    for picture in (
        plots.line_plot({}),
        plots.line_plot({"a": (empty, empty)}),
        plots.reliability_plot(empty, np.empty(0, bool)),
    ):
        assert picture.dtype == np.uint8
        assert picture.ndim == 3


_AT_BOTH_SIDES = (np.array([0.0, 0.0, np.nan, 1.0, 1.0]), np.array([0.0, 1.0, np.nan, 0.0, 1.0]))
_LEVELS = (0.0, 0.28, 0.5, 0.72, 1.0)


@pytest.mark.parametrize(
    "series",
    [
        {"above": ([0, 1], [1, 1]), "below": ([0, 1], [0, 0]), "at both sides": _AT_BOTH_SIDES},
        {f"worker {k}": ([0, 1], [level, level]) for k, level in enumerate(_LEVELS)},
    ],
    ids=["no corner is free, the middle is", "only strips are free"],
)
def test_the_legend_leaves_the_lines_free_where_there_is_room(series: dict) -> None:
    canvas, colors = Canvas.empty((-0.02, 1.02), (-0.1, 1.1)), COLOURS[: len(series)]
    for (xs, ys), color in zip(series.values(), colors, strict=True):
        canvas.line(np.asarray(xs, float), np.asarray(ys, float), color)
    before = canvas.picture.copy()
    picture = canvas.with_legend(list(series), colors)
    for color in colors:
        line = (before == color).all(-1)
        assert (picture[: len(before)][line] == color).all()
        assert (picture == color).all(-1).sum() > line.sum()


def test_a_legend_that_would_hide_something_stands_below_the_axes() -> None:
    canvas = Canvas.empty((0.0, 1.0), (0.0, 1.0))
    canvas.bar(0.0, 1.0, 0.0, 1.0, COLOURS[0])
    before = canvas.picture.copy()
    picture = canvas.with_legend(["all of it"], COLOURS[:1])
    assert (picture[: len(before)] == before).all()
    below = picture[len(before) :]
    assert (below == COLOURS[0]).all(-1).any()
    other = plots.beside([before, picture])
    assert other.shape == (len(picture), 2 * before.shape[1], 3)
