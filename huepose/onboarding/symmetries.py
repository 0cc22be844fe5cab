"""Turns under which shape *and print* look the same, found on geometry and texture, or declared.

Near-symmetries of the shape alone are hypotheses (turns.py). Here each of them is tried on the print: the
colours of the surface at where the surfels land must be those of the surfels, nearly everywhere.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.model.types import Surface
from huepose.onboarding.cloud import Cloud, averaged_lab
from huepose.onboarding.turns import NearSymmetries, turns_about

EQUIVALENT_STEP_RAD = np.radians(5.0)
SAME_SHAPE = 0.012  # mean distance to the own surface over the diameter
_POINTS = 1000


def equivalent_turns(surface: Surface, cloud: Cloud, near: NearSymmetries, diameter_m: float) -> Float64:
    """Turns (E, 4, 4), identity first, under which shape and print look the same.

    About an axis of revolution every 5 degrees where all of the tried turns look the same.
    """
    same = np.array(
        [
            k == 0 or (near.errors[k] < SAME_SHAPE and looks_the_same(surface, cloud, T))
            for k, T in enumerate(near.turns)
        ]
    )
    if near.axis is None or near.offset is None:
        return np.asarray(near.turns[same])
    half = len(near.turns) if near.flip is None else len(near.turns) // 2
    if not same[:half].all():
        return np.asarray(near.turns[same])
    about = turns_about(near.axis, near.offset, EQUIVALENT_STEP_RAD)
    if near.flip is None or not same[half:].all():
        return about
    return np.concatenate([about, near.flip @ about])


def looks_the_same(surface: Surface, cloud: Cloud, turn: Float64) -> bool:
    """True when the turned print cannot be told from the print."""
    difference = print_difference(surface, cloud, turn)
    return bool(np.mean(difference) < 4.0 and np.mean(difference > 12.0) < 0.01)


def print_difference(surface: Surface, cloud: Cloud, turn: Float64) -> Float64:
    """Distance in (L / 2, a, b) of surfels' coarse colours (N,) to those of the places where a turn takes
    them; 0 where the turned surfel lands off the surface or on its other side."""
    points = se3.apply(turn, surface.points[:_POINTS])
    normals = surface.normals[:_POINTS] @ turn[:3, :3].T
    there = averaged_lab(cloud, points, normals, 0.0035)
    delta = (there - surface.lab[1, :_POINTS]) * [0.5, 1.0, 1.0]
    nearest = cloud.tree.query(points)[1]
    faces = np.einsum("nd,nd->n", cloud.normals[nearest], normals) > 0.7
    return np.asarray(np.linalg.norm(delta, axis=1) * faces)
