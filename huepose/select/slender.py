"""Rotations of a slender object that count as no error: a handle that rolls half round moves by less than a
tenth of the object's length, so either pose is right and both are one answer (`select.distinct`). Its texture
may tell them apart all the same."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.model.types import ReferenceModel
from huepose.select.distinct import FINAL_TURN_RAD, different_answers


def rolls(model: ReferenceModel) -> Float64:
    """Its near-symmetric rotations (K, 4, 4) after which a pose counts as the same answer, though it looks
    different."""
    one = np.eye(4)
    same = [T for T in model.near_symmetries[1:] if len(different_answers(model, np.stack([one, T]))) == 1]
    apart = [min(se3.rotation_angle(T, equivalent) for equivalent in model.equivalents) for T in same]
    return np.array([T for T, angle in zip(same, apart, strict=True) if angle > FINAL_TURN_RAD]).reshape(
        -1, 4, 4
    )
