"""The canvas of a plot: axes with round ticks, a grid, labels, a legend. Data are drawn in their own
units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import cv2
import numpy as np

from huepose.geometry.arrays import Float, Int32, UInt8

Colour = tuple[int, int, int]
FONT, PAPER = cv2.FONT_HERSHEY_SIMPLEX, 248
INK: Colour = (40, 40, 40)
PALE: Colour = (225, 225, 225)
# The colours of Okabe and Ito, which colour-blind people can distinguish, too.
COLOURS: tuple[Colour, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (230, 159, 0),
    (90, 90, 90),
)
_LEFT, _RIGHT, _TOP, _BOTTOM = 78, 24, 46, 62
_SHIFT = 4
_SEARCH_PX = 2


def ticks(low: float, high: float, about: int = 6) -> list[float]:
    """About `about` round numbers in [low, high], in steps of 1, 2 or 5 times a power of ten.

    >>> ticks(0.0, 0.97)
    [0.0, 0.2, 0.4, 0.6, 0.8]
    """
    raw = (high - low) / max(about - 1, 1)
    power = float(10.0 ** np.floor(np.log10(raw)))
    step = power * min((m for m in (1, 2, 5, 10) if m * power >= raw * 0.999), default=10)
    first, last = int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6))
    return [round(k * step, 12) + 0.0 for k in range(first, last + 1)]


def limits(values: Float, zero: bool = False) -> tuple[float, float]:
    """A range that contains the finite values, with a margin of 4 %; with `zero` it starts at 0 if no value
    is negative."""
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if high - low < 1e-12:
        low, high = low - 0.5, high + 0.5
    room = 0.04 * (high - low)
    return (0.0 if zero and low >= 0 else low - room), high + room


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture with axes; `x` and `y` are the ranges that it shows. `Canvas.empty` makes one."""

    picture: UInt8
    x: tuple[float, float]
    y: tuple[float, float]

    @staticmethod
    def empty(
        x: tuple[float, float],
        y: tuple[float, float],
        title: str = "",
        x_label: str = "",
        y_label: str = "",
        size: tuple[int, int] = (720, 460),
        x_names: Sequence[str] | None = None,
    ) -> Canvas:
        """Axes, grid and labels on white; size (width, height) px. `x_names` label x = 0, 1, 2..."""
        canvas = Canvas(np.full((size[1], size[0], 3), 255, np.uint8), x, y)
        picture = canvas.picture
        for value in ticks(*y, about=7):
            v = round(float(canvas.pixels(np.array([[x[0], value]]))[0, 1]))
            cv2.line(picture, (_LEFT, v), (size[0] - _RIGHT, v), PALE, 1)
            _text(picture, _short(value), (_LEFT - 8, v), 0.48, "right")
        marks = (
            [(float(k), n) for k, n in enumerate(x_names)]
            if x_names
            else [(t, _short(t)) for t in ticks(*x, about=8)]
        )
        for value, name in marks:
            u = round(float(canvas.pixels(np.array([[value, y[0]]]))[0, 0]))
            if not x_names:
                cv2.line(picture, (u, _TOP), (u, size[1] - _BOTTOM), PALE, 1)
            _text(picture, name, (u, size[1] - _BOTTOM + 15), 0.48, "centre")
        cv2.rectangle(picture, (_LEFT, _TOP), (size[0] - _RIGHT, size[1] - _BOTTOM), INK, 1)
        _text(picture, title, (size[0] // 2, _TOP // 2 + 2), 0.62, "centre", 2)
        _text(picture, x_label, ((_LEFT + size[0] - _RIGHT) // 2, size[1] - 18), 0.54, "centre")
        side: UInt8 = np.full((26, size[1], 3), 255, np.uint8)
        _text(side, y_label, ((size[1] + _BOTTOM - _TOP) // 2, 13), 0.54, "centre")
        picture[:, 3:29] = np.minimum(picture[:, 3:29], np.rot90(side))
        return canvas

    def pixels(self, points: Float) -> Float:
        """Pixels (N, 2) of data points (N, 2)."""
        height, width = self.picture.shape[:2]
        u = _LEFT + (points[:, 0] - self.x[0]) / (self.x[1] - self.x[0]) * (width - _LEFT - _RIGHT)
        v = (
            height
            - _BOTTOM
            - (points[:, 1] - self.y[0]) / (self.y[1] - self.y[0]) * (height - _TOP - _BOTTOM)
        )
        return np.stack([u, v], -1)

    def line(self, x: Float, y: Float, color: Colour, thickness: int = 2, dashed: bool = False) -> None:
        """A line through points (N,), interrupted at nan and clipped to the axes, solid or dashed."""
        points: Float = np.stack([np.asarray(x, np.float64), np.asarray(y, np.float64)], -1)
        if dashed:
            points = _pieces(points, 40)
        inner = self._frame()
        for k in range(len(points) - 1):
            if np.isfinite(points[k : k + 2]).all() and not (dashed and k % 2):
                a, b = self._fixed(points[k : k + 2])
                cv2.line(inner, a, b, color, thickness, cv2.LINE_AA, _SHIFT)

    def dots(self, x: Float, y: Float, color: Colour, radius: float = 3.0) -> None:
        """Discs at points (N,), clipped to the axes."""
        inner = self._frame()
        points = np.stack([np.asarray(x, np.float64), np.asarray(y, np.float64)], -1)
        for at in self._fixed(points[np.isfinite(points).all(1)]):
            cv2.circle(inner, at, round(radius * 2**_SHIFT), color, -1, cv2.LINE_AA, _SHIFT)

    def bar(self, x0: float, x1: float, y0: float, y1: float, color: Colour) -> None:
        """A filled rectangle between data coordinates."""
        a, b = self._fixed(np.array([[x0, max(y0, y1)], [x1, min(y0, y1)]]))
        low, high = (tuple(round(v / 2**_SHIFT) for v in p) for p in (a, b))
        cv2.rectangle(self._frame(), (low[0], low[1]), (high[0], high[1]), color, -1)

    def band(self, x0: float, x1: float, color: Colour) -> None:
        """A band between two x over the whole height, behind what is drawn already."""
        inner = self._frame()
        (left, _), (right, _) = (
            (round(u / 2**_SHIFT), v) for u, v in self._fixed(np.array([[x0, 0.0], [x1, 0.0]]))
        )
        part = inner[:, max(left, 0) : max(right, 0)]
        part[:] = np.minimum(part, np.array(color, np.uint8))

    def note(self, text: str, x: float, y: float) -> None:
        """Text centred just above a data point."""
        at = self.pixels(np.array([[x, y]]))[0]
        _text(self.picture, text, (round(float(at[0])), round(float(at[1])) - 10), 0.46, "centre", 1, INK)

    def with_legend(self, names: Sequence[str], colors: Sequence[Colour]) -> UInt8:
        """The picture with a legend. It is placed where nothing is drawn: in a corner if possible, in
        several columns if only that fits, below the axes if no place is free."""
        if not names:
            return self.picture
        inner = self._frame()
        ink = inner.min(-1) < PALE[0] - 5
        wide = max(text_px(name, 0.48) for name in names) + 42
        layouts = [-(-len(names) // columns) for columns in range(1, max(2, len(names)))]

        sums = cv2.integral(ink.astype(np.uint8))

        def covered(rows: int) -> tuple[int, int, int, int]:
            """For a legend of that many rows: the pixels that it covers at best, the rows, its x and y."""
            width, height = wide * -(-len(names) // rows), 20 * rows + 8
            right, bottom = max(0, inner.shape[1] - width - 8), max(0, inner.shape[0] - height - 8)
            corners = [(right, 8), (8, 8), (right, bottom), (8, bottom)]
            between = product(range(8, right + 1, _SEARCH_PX), range(8, bottom + 1, _SEARCH_PX))
            x, y = np.array([*corners, *between]).T
            far_x, far_y = (
                np.minimum(e, n) for e, n in zip((x + width, y + height), ink.shape[::-1], strict=True)
            )
            hidden = sums[far_y, far_x] - sums[y, far_x] - sums[far_y, x] + sums[y, x]
            best = int(np.argmin(hidden))
            return int(hidden[best]), rows, int(x[best]), int(y[best])

        hidden, rows, x, y = min((covered(rows) for rows in layouts), key=lambda place: place[0])
        picture, on = self.picture, inner
        if hidden:
            columns = max(1, (picture.shape[1] - _LEFT - _RIGHT) // wide)
            rows = -(-len(names) // columns)
            strip: UInt8 = np.full((20 * rows + 12, picture.shape[1], 3), 255, np.uint8)
            picture = np.concatenate([picture, strip])
            on, x, y = picture[-len(strip) :], _LEFT, 0
        else:
            plate = inner[y : y + 20 * rows + 8, x : x + wide * -(-len(names) // rows)]
            plate[:] = (0.15 * plate + 0.85 * 255).astype(np.uint8)
        for k, (name, color) in enumerate(zip(names, colors, strict=True)):
            left, row = x + wide * (k // rows), y + 14 + 20 * (k % rows)
            cv2.line(on, (left + 6, row), (left + 28, row), color, 3, cv2.LINE_AA)
            _text(on, name, (left + 34, row), 0.48, "left")
        return picture

    def _frame(self) -> UInt8:
        """The part of the picture inside the axes, a view."""
        return self.picture[_TOP:-_BOTTOM, _LEFT:-_RIGHT]

    def _fixed(self, points: Float) -> list[tuple[int, int]]:
        """Positions inside the axes in OpenCV's fixed-point pixels, clipped to a range that it can draw."""
        inner: Int32 = np.rint(np.clip(self.pixels(points) - (_LEFT, _TOP), -9000, 9000) * 2**_SHIFT).astype(
            np.int32
        )
        return [(int(u), int(v)) for u, v in inner]


def _short(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e5 else f"{value:.3g}"


def _pieces(points: Float, n: int) -> Float:
    """A polyline (N, 2) cut into about `n` pieces in all."""
    per = max(2, n // max(len(points) - 1, 1))
    parts = [np.linspace(a, b, per, endpoint=False) for a, b in pairwise(points)]
    return np.concatenate([*parts, points[-1:]])


def _text(
    picture: UInt8,
    text: str,
    at: tuple[int, int],
    scale: float,
    side: str,
    thickness: int = 1,
    color: Colour = INK,
) -> None:
    """Text with its left end, middle or right end (`side`) at a pixel, centred vertically."""
    (width, height), _ = cv2.getTextSize(text, FONT, scale, thickness)
    x = at[0] - {"left": 0, "centre": width // 2, "right": width}[side]
    cv2.putText(picture, text, (x, at[1] + height // 2), FONT, scale, color, thickness, cv2.LINE_AA)


LINE_PX, MARGIN_PX = 18, 8


def text_px(text: str, scale: float) -> int:
    """Width of a text."""
    return int(cv2.getTextSize(text, FONT, scale, 1)[0][0])


def wrapped(text: str, width: int, scale: float) -> list[str]:
    """Text broken into lines of at most `width` pixels. A word that is wider gets its own line."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and text_px(longer, scale) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def paragraph(text: str, width: int, scale: float = 0.45) -> UInt8:
    """Text broken into lines, a picture (H, width, 3) uint8 RGB. A word that is wider gets its own line and
    is cut off."""
    lines = [line for part in text.split("\n") for line in wrapped(part, width - 2 * MARGIN_PX, scale)]
    page: UInt8 = np.full((LINE_PX * len(lines) + MARGIN_PX, width, 3), PAPER, np.uint8)
    for k, line in enumerate(lines):
        cv2.putText(page, line, (MARGIN_PX, LINE_PX * (k + 1)), FONT, scale, INK, 1, cv2.LINE_AA)
    return page
