"""Shelf packing of rectangles, for a texture atlas."""

from __future__ import annotations

from collections.abc import Sequence


def on_shelves(sizes: Sequence[tuple[int, int]], limit: int) -> tuple[list[tuple[int, int]], int, int]:
    """Top-left corners (x, y) of rectangles (height, width), and the width and height of the whole. The
    tallest are placed first. A shelf is at most `limit` wide, or as wide as one wider rectangle.

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
