"""Numbers in sentences."""

from __future__ import annotations


def counted(number: int, thing: str) -> str:
    """So many of a thing whose plural ends in s.

    >>> counted(1, "object"), counted(0, "pose"), counted(20, "label")
    ('1 object', '0 poses', '20 labels')
    """
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def rounded(value: float) -> str:
    """A number to two digits that count, so that a sentence with it stays the same while it wavers.

    >>> rounded(941.3), rounded(6.42), rounded(0.0984), rounded(1242000.0), rounded(0.0)
    ('940', '6.4', '0.098', '1200000', '0')
    """
    return f"{float(f'{value:.2g}'):.10g}"
