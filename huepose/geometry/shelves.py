"""Rectangles packed on shelves, as pictures into one texture."""

from __future__ import annotations

from collections.abc import Sequence


def on_shelves(sizes: Sequence[tuple[int, int]], limit: int) -> tuple[list[tuple[int, int]], int, int]:
    """Top-left places (x, y) of rectangles (height, width), the tallest first, on shelves that are as wide as
    `limit` or as one rectangle; and the width and height of the whole.

    >>> on_shelves([(2, 3), (4, 3), (1, 3)], 6)
    ([(3, 0), (0, 0), (0, 4)], 6, 5)
    """
    places = [(0, 0)] * len(sizes)
    x = y = shelf = width = 0
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i][0]):
        h, w = sizes[i]
        if x + w > limit:
            x, y, shelf = 0, y + shelf, 0
        places[i] = (x, y)
        x, shelf, width = x + w, max(shelf, h), max(width, x + w)
    return places, width, y + shelf
