"""Rotations under which shape *and texture* look the same, found on geometry and texture.

Near-symmetries of the shape alone are hypotheses (near_symmetries.py). Here each of them is held against the
surface closely, and tried on the texture: the colours at the places where the surfels land must be those of
the surfels, nearly everywhere, both coarse and fine.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.model.types import Surface
from huepose.onboarding.cloud import Cloud, averaged_lab
from huepose.onboarding.near_symmetries import NearSymmetries, rotations_about
from huepose.onboarding.sided import SidedSurface
from huepose.onboarding.surface import COLOR_SIGMAS_M

EQUIVALENT_STEP_RAD = np.radians(5.0)
_CLOSE = 0.006  # mean distance to the own surface over the diameter
_FAR = 0.03  # a surfel this far from it stands for a handle, a spout, a hole
_FAR_SHARE = 0.03
_MEAN_COLOR, _OTHER_COLOR, _OTHER_SHARE = 3.0, 12.0, 0.03  # distances in (L / 2, a, b)
_POINTS = 800
_GLANCE = 150  # points that settle most cases


def equivalent_rotations(surface: Surface, cloud: Cloud, near: NearSymmetries, diameter_m: float) -> Float64:
    """Rotations (E, 4, 4), identity first, under which shape and texture look the same.

    About an axis of revolution every 5 degrees where all of the tried rotations look the same, else the
    largest set of equal steps that do.
    """
    sided = SidedSurface.of(cloud.points, cloud.normals, diameter_m)
    same = np.array(
        [k == 0 or looks_the_same(surface, cloud, sided, T) for k, T in enumerate(near.transforms)]
    )
    if near.axis is None or near.offset is None:
        return np.asarray(near.transforms[same])
    steps = len(near.transforms) if near.flip is None else len(near.transforms) // 2
    order = _order_of_subgroup(same[:steps])
    about = rotations_about(near.axis, near.offset, EQUIVALENT_STEP_RAD)
    if order < steps:
        about = near.transforms[: steps : steps // order]
    if near.flip is None or not same[steps :: steps // order].all():
        return np.asarray(about)
    return np.concatenate([about, near.flip @ about])


def _order_of_subgroup(same: Bool) -> int:
    """The most equal steps of a circle, all of which look the same; same (n,): for n equal steps."""
    count = len(same)
    return max(n for n in range(1, count + 1) if count % n == 0 and same[:: count // n].all())


def looks_the_same(surface: Surface, cloud: Cloud, sided: SidedSurface, turn: Float64) -> bool:
    """True when neither the turned shape nor the turned texture can be told from the object."""
    for count in (_GLANCE, _POINTS):
        # At a glance only what is clearly different is turned away.
        slack = 2.5 if count == _GLANCE else 1.0
        points = surface.points[:count].astype(np.float64)
        plane, distance = sided.offsets(turn, points, surface.normals[:count].astype(np.float64))
        if plane.mean() > slack * _CLOSE or (distance > _FAR).mean() > slack * _FAR_SHARE:
            return False
        for scale in (1, 0):
            difference = texture_difference(surface, cloud, turn, scale, count)
            other = (difference > _OTHER_COLOR).mean() > slack * _OTHER_SHARE
            if other or (scale == 1 and difference.mean() > slack * _MEAN_COLOR):
                return False
    return True


def texture_difference(surface: Surface, cloud: Cloud, turn: Float64, scale: int, count: int) -> Float64:
    """Distance in (L / 2, a, b) of the colours of `count` surfels, at one of the two scales of `Surface.lab`,
    to those of the places where a turn takes them (count,)."""
    points = se3.apply(turn, surface.points[:count])
    normals = surface.normals[:count] @ turn[:3, :3].T
    there = averaged_lab(cloud, points, normals, COLOR_SIGMAS_M[scale])
    return np.asarray(np.linalg.norm((there - surface.lab[scale, :count]) * [0.5, 1.0, 1.0], axis=1))
