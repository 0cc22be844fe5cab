"""Plots as pictures (H, W, 3) uint8 RGB, by OpenCV alone: lines, dots, bars, reliability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from huepose.drawing.canvas import COLOURS, INK, Canvas, Colour, limits
from huepose.geometry.arrays import Bool, Float, UInt8

Series = Mapping[str, tuple[Float, Float]]
Range = tuple[float, float]


def line_plot(
    series: Series,
    title: str = "",
    x_label: str = "",
    y_label: str = "",
    x_range: Range | None = None,
    y_range: Range | None = None,
    marks: bool = False,
    bands: Sequence[tuple[float, float, Colour]] = (),
    size: tuple[int, int] = (720, 460),
) -> UInt8:
    """A line for each name: x (N,), y (N,), interrupted where either is nan; marks: a dot at each point;
    bands: coloured backgrounds from one x to another."""
    every = [np.empty(0), *(np.asarray(v, np.float64) for pair in series.values() for v in pair)]
    x_shown = x_range or limits(np.concatenate(every[1::2] or [np.empty(0)]))
    y_shown = y_range or limits(np.concatenate(every[2::2] or [np.empty(0)]), zero=True)
    canvas = Canvas.empty(x_shown, y_shown, title, x_label, y_label, size)
    for left, right, color in bands:
        canvas.band(left, right, color)
    for (x, y), color in zip(series.values(), _colours(len(series)), strict=True):
        canvas.line(x, y, color)
        if marks:
            canvas.dots(x, y, color, 3.5)
    return canvas.with_legend(list(series), _colours(len(series)))


def bar_chart(
    groups: Sequence[str],
    series: Mapping[str, Sequence[float]],
    title: str = "",
    y_label: str = "",
    y_range: Range | None = None,
    size: tuple[int, int] = (720, 460),
    notes: bool = True,
) -> UInt8:
    """For each group one bar per series, side by side; notes: their values on top."""
    heights = np.array([list(v) for v in series.values()], np.float64).reshape(len(series), len(groups))
    span = y_range or (0.0, 1.22 * float(np.nanmax(heights, initial=1e-9)))
    canvas = Canvas.empty((-0.6, len(groups) - 0.4), span, title, "", y_label, size, x_names=groups)
    width = 0.8 / max(len(series), 1)
    for row, color, k in zip(heights, _colours(len(series)), range(len(series)), strict=True):
        for group, height in enumerate(row):
            left = group - 0.4 + k * width
            if np.isfinite(height):
                canvas.bar(left + 0.06 * width, left + 0.94 * width, span[0], float(height), color)
            if not notes or not np.isfinite(height):
                continue
            canvas.note(
                f"{height:.3g}" if height >= 0.1 else f"{height:.2f}",
                left + width / 2,
                min(float(height), span[1]),
            )
    return canvas.with_legend(list(series), _colours(len(series)))


def beside(pictures: Sequence[UInt8]) -> UInt8:
    """Pictures in a row, filled up with white below the shorter ones."""
    height = max(len(picture) for picture in pictures)
    padded = [np.pad(one, ((0, height - len(one)), (0, 0), (0, 0)), constant_values=255) for one in pictures]
    return np.asarray(np.hstack(padded), np.uint8)


def reliability_bins(quality: Float, right: Bool, bins: int = 10) -> tuple[Float, Float, Float]:
    """Mean quality (B,), share of right poses (B,) and count (B,) of bins with equal counts, sorted by
    quality.

    quality (N,) in 0..1; right (N,) bool. Fewer than `bins` bins if there are fewer values.
    """
    order = np.argsort(quality, kind="stable")
    parts = [part for part in np.array_split(order, bins) if len(part)]
    stated = np.array([np.mean(np.asarray(quality)[part]) for part in parts])
    true = np.array([np.mean(np.asarray(right)[part]) for part in parts])
    return stated, true, np.array([len(part) for part in parts], np.float64)


def reliability_plot(quality: Float, right: Bool, bins: int = 10, title: str = "") -> UInt8:
    """Stated quality against the share of right poses, in bins of equal count; on the diagonal both are
    equal."""
    stated, true, count = reliability_bins(quality, right, bins)
    canvas = Canvas.empty((0.0, 1.0), (0.0, 1.0), title, "stated quality", "share that is right", (520, 480))
    canvas.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), INK, 1, dashed=True)
    canvas.line(stated, true, COLOURS[0])
    canvas.dots(stated, true, COLOURS[0], 4.5)
    return canvas.with_legend([f"{int(count.sum())} poses, {len(count)} bins"], [COLOURS[0]])


def _colours(n: int) -> list[Colour]:
    return [COLOURS[k % len(COLOURS)] for k in range(n)]
