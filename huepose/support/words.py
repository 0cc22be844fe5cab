"""Numbers in sentences."""

from __future__ import annotations


def counted(number: int, thing: str) -> str:
    """So many of a thing whose plural ends in s.

    >>> counted(1, "object"), counted(0, "pose"), counted(20, "label")
    ('1 object', '0 poses', '20 labels')
    """
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
