"""The uncertainty of a pose: its covariance, which is published, and the expected error of its points.

A covariance has the order tx ty tz rx ry rz, metres and radians, about the object's origin, camera axes. The
refinement's information counts residuals as if their errors were independent. Those of neighbouring pixels
are not, and a sensor and a scanned model have errors that are the same everywhere, which no number of samples
averages out."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64
from huepose.geometry.camera import depth_noise_m
from huepose.geometry.frame import RgbdFrame
from huepose.judge.borders import held
from huepose.refine.photometric import RESIDUALS_PER_READING
from huepose.refine.solver import solve_symmetric, transform
from huepose.support.jit import jit
from huepose.tracking.evidence import is_loose
from huepose.tracking.hypothesis import Hypothesis
from huepose.tracking.subject import Subject

FIXED = 0.012
"""Expected pose error, as a share of the diameter, up to which the texture fixes the pose; that of textured
objects is half as large."""

FLOOR_SIGMA = np.array([0.0003, 0.0003, 0.0005, 0.004, 0.004, 0.004])
"""Least standard errors of a pose, metres along camera axes and radians, however many pixels support it: what
the errors of a model leave."""

BIAS_SHARE = 0.15
"""Share of the depth sensor's noise that is common to all readings of an object."""

LEAST_INSIDE = 0.05
"""The share inside the image counts as at least this. Errors grow with its inverse root: medians of error
over expected error in 5,900 frames of rendered objects that the image border cuts."""

WEAK_SIGMA = np.array([0.05, 0.05, 0.05, 0.5, 0.5, 0.5])
"""Standard errors without any measurement: the object was tracked a moment ago."""

DISTANCES_M = tuple(0.1 * k for k in range(2, 21))
"""Distances that `exact_within_m` tries: from where depth cameras begin to 2 m."""

_NOTHING = np.zeros((6, 6))


def uncertainty(subject: Subject, h: Hypothesis, frame: RgbdFrame | None = None) -> tuple[Float64, float]:
    """Covariance (6, 6) of a pose, and its expected error as a share of the diameter. If depth and texture do
    not fix the pose and `frame` is given, the outline in that frame is used, too."""
    known, spread = _uncertainty(subject, h, _NOTHING)
    if frame is None or spread < FIXED:
        return known, spread
    return _uncertainty(subject, h, held(subject.contours, h.T_cam_obj, frame))


def _uncertainty(subject: Subject, h: Hypothesis, by_outline: Float64) -> tuple[Float64, float]:
    # A copy: for each kind of array the kernel would be compiled once more.
    surface, T, known = subject.surface, np.array(h.T_cam_obj, np.float64, order="C"), np.empty((6, 6))
    centre = surface.centre_cam(T)
    # Errors common to all readings rotate the object about the part inside the image.
    inside = max(1.0 - h.terms.outside, LEAST_INSIDE)
    bias_m = BIAS_SHARE * depth_noise_m(float(centre[2]))
    _about_origin(h.information, by_outline, bias_m, T[:3, 3] - centre, inside, known)
    return known, spread_m(known, T, subject.points[0]) / surface.diameter_m


def covariance(information: Float64, distance_m: float, by_outline: Float64 = _NOTHING) -> Float64:
    """Covariance (6, 6) of a refined pose at that distance, about the point that the information (6, 6) is
    about; by_outline (6, 6): information of the outline about the same point."""
    out = np.empty((6, 6))
    _covariance(information, by_outline, BIAS_SHARE * depth_noise_m(distance_m), out)
    return out


def exact_within_m(points: Float64, diameter_m: float) -> float:
    """The largest of `DISTANCES_M` at which an object with these points (N, 3), about its centre, can be
    TRACKING at all: farther away the floors alone make every pose `is_loose`. 0 if they do so everywhere."""
    certain = np.eye(6) / np.finfo(np.float64).eps
    spreads = [spread_m(covariance(certain, z), np.eye(4), points) / diameter_m for z in DISTANCES_M]
    return max(
        (z for z, spread in zip(DISTANCES_M, spreads, strict=True) if not is_loose(spread)), default=0.0
    )


@jit
def _covariance(information: Float64, by_outline: Float64, bias_m: float, out: Float64) -> None:
    """Fill `out` (6, 6)."""
    A, unit, column = np.empty((6, 6)), np.zeros(6), np.empty(6)
    for k in range(6):
        for i in range(6):
            for j in range(6):
                A[i, j] = information[i, j] / RESIDUALS_PER_READING + by_outline[i, j]
            A[i, i] += 1.0 / WEAK_SIGMA[i] ** 2
        unit[:] = 0.0
        unit[k] = 1.0
        solve_symmetric(A, unit, column)
        for i in range(6):
            out[i, k] = column[i]
        out[k, k] += FLOOR_SIGMA[k] ** 2
    out[2, 2] += bias_m**2


@jit
def _about_origin(
    information: Float64, by_outline: Float64, bias_m: float, lever: Float64, inside: float, out: Float64
) -> None:
    """Fill `out` (6, 6): the covariance about the object's origin, for information (6, 6) about it. Prior and
    floors are about the object's centre, wherever the origin is. lever (3,): from the centre to the origin,
    camera axes; inside: the share of the object in the image."""
    x, y, z = lever[0], lever[1], lever[2]
    to_origin, about_centre = np.eye(6), np.empty((6, 6))
    to_origin[0, 4], to_origin[0, 5] = z, -y
    to_origin[1, 3], to_origin[1, 5] = -z, x
    to_origin[2, 3], to_origin[2, 4] = y, -x
    transform(to_origin, information, about_centre)
    _covariance(about_centre, by_outline, bias_m, out)
    about_centre[:] = out
    transform(to_origin.T, about_centre, out)
    out /= inside


@jit
def spread_m(covariance: Float64, T: Float64, points: Float64) -> float:
    """RMS displacement of the object's points (N, 3) at a pose T_cam_obj (4, 4), if its error has this
    covariance (6, 6)."""
    square = 0.0
    for k in range(points.shape[0]):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        p0 = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z
        p1 = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z
        p2 = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z
        # A point p moves by t + r x p.
        square += p2 * p2 * (covariance[3, 3] + covariance[4, 4]) - 2.0 * p1 * p2 * covariance[4, 5]
        square += p1 * p1 * (covariance[3, 3] + covariance[5, 5]) - 2.0 * p0 * p2 * covariance[3, 5]
        square += p0 * p0 * (covariance[4, 4] + covariance[5, 5]) - 2.0 * p0 * p1 * covariance[3, 4]
        square += 2.0 * p0 * (covariance[1, 5] - covariance[2, 4])
        square += 2.0 * p1 * (covariance[2, 3] - covariance[0, 5])
        square += 2.0 * p2 * (covariance[0, 4] - covariance[1, 3])
    return float(np.sqrt(square / points.shape[0] + covariance[0, 0] + covariance[1, 1] + covariance[2, 2]))
