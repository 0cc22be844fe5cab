"""Numbers and names as text."""

from __future__ import annotations

import difflib
from collections.abc import Sequence


def counted(number: int, thing: str) -> str:
    """A number with a noun whose plural ends in s.

    >>> counted(1, "object"), counted(0, "pose"), counted(20, "label")
    ('1 object', '0 poses', '20 labels')
    """
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def known(value: float | None, form: str = ".1f", unit: str = "") -> str:
    """A number, or a dash if it is not known.

    >>> known(93.27), known(None, ".3f"), known(1.5, ".2f", " s")
    ('93.3', '-', '1.50 s')
    """
    return "-" if value is None else f"{value:{form}}{unit}"


def first_of(names: Sequence[str], most: int) -> str:
    """The first `most` names with commas between them, and how many more there are.

    >>> first_of(["box", "can", "mug"], 3), first_of(["box", "can", "mug"], 1)
    ('box, can, mug', 'box and 2 more')
    """
    left = len(names) - most
    return ", ".join(names[:most]) + (f" and {left} more" if left > 0 else "")


def listed(names: Sequence[str], longest: int = 200) -> str:
    """As many names as `longest` characters hold, with commas between them, and how many more there are.

    >>> listed(["box", "can", "mug"]), listed(["box", "tin can", "mug", "jug"], 14)
    ('box, can, mug', 'box, tin can and 2 more')
    """
    most = len(names)
    while len(", ".join(names[:most])) > longest and most > 1:
        most -= 1
    return first_of(names, most)


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """A question that names the most similar of the known words; empty if none is similar.

    >>> did_you_mean("mugg", ["can", "mug"]), did_you_mean("mug", ["can"])
    ("Did you mean 'mug'?", '')
    """
    meant = difflib.get_close_matches(word, known, 1)
    return f"Did you mean '{meant[0]}'?" if meant else ""


def rounded(value: float) -> str:
    """A number with two significant digits, so that a sentence stays the same while it varies a little.

    >>> rounded(941.3), rounded(6.42), rounded(0.0984), rounded(1242000.0), rounded(0.0)
    ('940', '6.4', '0.098', '1200000', '0')
    """
    return f"{float(f'{value:.2g}'):.10g}"


def beside(right_px: float, down_px: float, decimals: int = 0) -> str:
    """Distance and direction in the image, to be followed by a noun; empty if both are below half a pixel.

    >>> beside(6.0, 0.0), beside(-1.0, -1.0), beside(0.2, 5.4), beside(0.2, -0.3)
    ('6 px to the right of', '1 px to the left and 1 px above', '5 px below', '')
    """
    across = f"{abs(right_px):.{decimals}f} px to the {'right' if right_px > 0 else 'left'}"
    along = f"{abs(down_px):.{decimals}f} px {'below' if down_px > 0 else 'above'}"
    way = [words for words, x in ((across, right_px), (along, down_px)) if abs(x) >= 0.5]
    return " and ".join(way) + (" of" if way == [across] else "")
