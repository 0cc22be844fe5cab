"""Wrong rotations in words: about which axes of the object, by which angles, and what to do about them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.onboarding.symmetries import ALONG, AXES


def rotations_in_words(turns: Sequence[Float64]) -> str:
    """Counts and angles of rotation vectors (3,) by the object's axis, the most frequent first.

    >>> rotations_in_words([np.array([0.0, 0.0, 3.1]), np.array([0.1, 0.0, -1.0]), np.array([1.0, 1.0, 0.0])])
    '2 about its z axis by 58 to 178 deg, 1 about a slanted axis by 81 deg'
    """
    groups: dict[str | None, list[float]] = {}
    for turn in turns:
        groups.setdefault(_axis(turn), []).append(float(np.degrees(np.linalg.norm(turn))))
    return ", ".join(
        f"{len(angles)} about {f'its {axis} axis' if axis else 'a slanted axis'} by {_span(angles)} deg"
        for axis, angles in sorted(groups.items(), key=lambda group: -len(group[1]))
    )


def _axis(turn: Float64) -> str | None:
    """The object's axis along which a rotation vector (3,) is, None for a slanted one."""
    cosines = np.abs(turn) / np.linalg.norm(turn)
    return AXES[int(cosines.argmax())] if cosines.max() > ALONG else None


def advice(turns: Sequence[Float64]) -> str:
    """What to do if most rotation vectors (3,) are along one axis; else empty.

    >>> advice([np.array([0.0, 0.0, 3.1]), np.array([0.0, 0.0, -1.0]), np.array([0.0, 2.0, 0.0])])
    ' If the rotation about z does not matter, onboard it with --symmetric z: then it is no error.'
    >>> advice([np.array([0.0, 0.0, 3.1]), np.array([0.0, 2.0, 0.0])])
    ''
    """
    axis, count = Counter(_axis(turn) for turn in turns).most_common(1)[0]
    if axis is None or 2 * count <= len(turns):
        return ""
    return (
        f" If the rotation about {axis} does not matter, onboard it with --symmetric {axis}: then it is no "
        "error."
    )


def _span(angles: Sequence[float]) -> str:
    low, high = f"{min(angles):.0f}", f"{max(angles):.0f}"
    return low if low == high else f"{low} to {high}"
