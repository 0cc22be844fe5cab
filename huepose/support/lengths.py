"""Units of length in which a mesh may be, and lengths in words."""

from __future__ import annotations

from typing import Literal

Unit = Literal["mm", "cm", "m", "in", "ft"]
METRES: dict[Unit, float] = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254, "ft": 0.3048}

NAMES: dict[Unit, str] = {
    "mm": "millimetres",
    "cm": "centimetres",
    "m": "metres",
    "in": "inches",
    "ft": "feet",
}

LIKELY: tuple[Unit, ...] = ("m", "mm")
"""The units that are guessed where none is given, the likelier first."""


def length(metres: float) -> str:
    """A length in the unit in which a person would say it.

    >>> length(1.5), length(0.15), length(0.005)
    ('1.5 m', '15 cm', '5 mm')
    """
    if metres >= 1.0:
        return f"{number(metres)} m"
    return f"{metres * 100:.4g} cm" if metres >= 0.01 else f"{number(metres * 1000)} mm"


def number(x: float) -> str:
    """Four figures, and no power of ten where a person can do without.

    >>> number(120000.0), number(9.2)
    ('120000', '9.2')
    """
    return f"{x:.0f}" if 1e4 <= x < 1e9 else f"{x:.4g}"
