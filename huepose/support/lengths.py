"""Units of length of meshes, and lengths as text."""

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
"""Units that are assumed if none is given, the more likely first."""


def length(metres: float) -> str:
    """A length as text, in m, cm or mm by its size.

    >>> length(1.5), length(0.15), length(0.005)
    ('1.5 m', '15 cm', '5 mm')
    """
    if metres >= 1.0:
        return f"{number(metres)} m"
    return f"{metres * 100:.4g} cm" if metres >= 0.01 else f"{number(metres * 1000)} mm"


def number(x: float) -> str:
    """A number with four significant digits, without a power of ten up to 1e9.

    >>> number(120000.0), number(9.2)
    ('120000', '9.2')
    """
    return f"{x:.0f}" if 1e4 <= x < 1e9 else f"{x:.4g}"
