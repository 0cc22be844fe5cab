"""Find symmetries of shape *and texture*: rotations after which the object looks the same.

The near-symmetries of the shape (`near_symmetries`) are candidates. Each is tested strictly on the surface
and then on the texture: almost all surfels, after the rotation, must have nearly the same colour as the
surface at their new position, at both colour scales.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float64
from huepose.model.types import COLOR_SCALES_M, Surface
from huepose.onboarding.cloud import Cloud, averaged_lab
from huepose.onboarding.near_symmetries import NearSymmetries, SidedSurface, revolves, rotations_about
from huepose.support.errors import InputError

EQUIVALENT_STEP_RAD = np.radians(5.0)  # between the rotations that are listed for an axis of revolution
AXES = ("x", "y", "z")
ALONG = 0.95  # least cosine at which an axis of rotation counts as an axis of the object
_ONE_AXIS = np.cos(np.radians(3.0))  # least cosine of two axes that count as one; flips are 7.5 degrees apart
_MAX_MEAN_ERROR = 0.006  # mean distance to the object's own surface over the diameter
_OUTLIER_ERROR = 0.03  # distance of an outlier over the diameter, as on a handle, a spout, a hole
_MAX_OUTLIERS = 0.03  # largest share of outliers
_MAX_MEAN_COLOR, _OUTLIER_COLOR, _MAX_COLOR_OUTLIERS = 3.0, 12.0, 0.03  # distances in (L / 2, a, b); share
_POINTS = 800  # surfels of the full test
_QUICK_POINTS = 150  # surfels of a first test, which rejects most rotations


def equivalent_rotations(surface: Surface, cloud: Cloud, near: NearSymmetries, diameter_m: float) -> Float64:
    """Rotations (E, 4, 4), identity first, after which shape and texture look the same.

    About an axis of revolution: one every 5 degrees if the object looks the same after all tested
    rotations, otherwise the largest set of equal steps after which it does.
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


def rotations_about_own(surface: Surface, near: NearSymmetries, diameter_m: float, axis: str) -> Float64:
    """Rotations (E, 4, 4), identity first, about an axis of the object ("x", "y" or "z") after which its
    shape is nearly the same; the texture does not count. About an axis of revolution: one every 5 degrees.

    Raises InputError if the shape has no such rotation.
    """
    along = np.eye(3)[AXES.index(axis)]
    if near.axis is not None and near.offset is not None:
        across = np.cross(near.axis, np.eye(3)[np.argmin(np.abs(near.axis))])
        if revolves(surface, diameter_m, across / np.linalg.norm(across), near.offset):  # a ball
            return rotations_about(along, near.offset, EQUIVALENT_STEP_RAD)
        if abs(along @ near.axis) > ALONG:
            return rotations_about(near.axis, near.offset, EQUIVALENT_STEP_RAD)
    vectors = np.array([se3.rotation_log(T[:3, :3]) for T in near.transforms])
    axes = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    nearest = axes[np.argmax(np.abs(axes @ along))]
    if abs(nearest @ along) < ALONG:
        raise InputError(
            f"--symmetric {axis}",
            found=f"no rotation about the object's {axis} axis after which its shape is nearly the same",
            expected="an axis with such a rotation",
            fix="The sheet of `huepose onboard` shows the axes; a file can declare any rotation.",
        )
    about = np.abs(axes @ nearest) > _ONE_AXIS
    about[0] = True
    return np.asarray(near.transforms[about])


def _order_of_subgroup(same: Bool) -> int:
    """Order of the largest cyclic group of rotations after which the object looks the same; same (n,): the
    results of n equal steps."""
    count = len(same)
    return max(n for n in range(1, count + 1) if count % n == 0 and same[:: count // n].all())


def looks_the_same(surface: Surface, cloud: Cloud, sided: SidedSurface, rotation: Float64) -> bool:
    """Whether shape and texture look the same after a rotation (4, 4)."""
    for count in (_QUICK_POINTS, _POINTS):
        # The quick test rejects only clear differences.
        slack = 2.5 if count == _QUICK_POINTS else 1.0
        points = surface.points[:count].astype(np.float64)
        plane, distance = sided.offsets(rotation, points, surface.normals[:count].astype(np.float64))
        if (
            plane.mean() > slack * _MAX_MEAN_ERROR
            or (distance > _OUTLIER_ERROR).mean() > slack * _MAX_OUTLIERS
        ):
            return False
        for scale in (1, 0):
            difference = texture_difference(surface, cloud, rotation, scale, count)
            other = (difference > _OUTLIER_COLOR).mean() > slack * _MAX_COLOR_OUTLIERS
            if other or (scale == 1 and difference.mean() > slack * _MAX_MEAN_COLOR):
                return False
    return True


def texture_difference(surface: Surface, cloud: Cloud, rotation: Float64, scale: int, count: int) -> Float64:
    """Colour distances (count,) in (L / 2, a, b) between `count` surfels and the surface at their positions
    after the rotation, at one of the two scales of `Surface.lab`."""
    points = se3.apply(rotation, surface.points[:count])
    normals = surface.normals[:count] @ rotation[:3, :3].T
    there = averaged_lab(cloud, points, normals, COLOR_SCALES_M[scale])
    return np.asarray(np.linalg.norm((there - surface.lab[scale, :count]) * [0.5, 1.0, 1.0], axis=1))
