"""How well the measurements determine where the camera is on the robot, and which ones are missing.

The covariance of the result is that of least squares, with the variances of the residuals (3N - 6 degrees of
freedom each) of positions and of rotations times the lever: an object's rotation is seldom as exact as its
position. With equal variances of 1 it is the error of the result relative to the error of one measurement. If
the result has a larger error than one measurement, more measurements are needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.geometry.hand_eye import HandEye, lever, moves, residuals

WANTED_RAD = np.radians(30.0)
"""Rotation of the hand to either side in the measurements to add: most arms can do it, and the object stays
in view."""

_MOST_MORE = 40
_STEP = 1e-5
_EQUAL = np.ones(2)


@dataclass(frozen=True, eq=False)
class Certainty:
    """shift_m, turn_rad: one standard deviation of the camera's position and orientation, in the worst
    direction; shift_ratio, turn_ratio: the same relative to one measurement whose rotation, times the lever,
    is as exact as its position. axis (3,): the axis about which the hand rotated least, in the frame of the
    camera's mount; turned_rad: RMS rotation between two poses about it; most_rad: the same about the axis
    with the most rotation. more: how many further measurements, rotated by WANTED_RAD about all axes, bring
    both ratios to 1; None if 40 do not."""

    shift_m: float
    turn_rad: float
    shift_ratio: float
    turn_ratio: float
    axis: Float64
    turned_rad: float
    most_rad: float
    more: int | None

    @property
    def well(self) -> bool:
        """Whether the error of the result is at most that of one measurement."""
        return self.more == 0


def certainty(A: Float64, B: Float64, found: HandEye) -> Certainty:
    """The certainty of `found`, the result of `hand_eye.solve(A, B)`."""
    lever_m = lever(B)
    rest = residuals(A, B, found.X, found.Y, lever_m).reshape(2, -1)
    sigma_m = np.sqrt((rest**2).sum(1) / (rest.shape[1] - 6))
    gain = _gain(A, found, lever_m)
    shift_m, turn_m = _errors(gain, lever_m, sigma_m)
    _, alpha = moves(A)
    _, turned, axes = np.linalg.svd(alpha)
    turned = turned / np.sqrt(len(alpha))
    return Certainty(
        shift_m,
        turn_m / lever_m,
        *_errors(gain, lever_m, _EQUAL),
        axes[2] * np.sign(axes[2][np.argmax(np.abs(axes[2]))]),
        float(turned[2]),
        float(turned[0]),
        _more(A, found, lever_m, axes),
    )


def _gain(A: Float64, found: HandEye, lever_m: float) -> Float64:
    """How the result (12,), steps of X and Y, changes with the residuals: (12, 6N)."""
    X, Y = found.X, found.Y
    B = np.array([se3.inverse(a @ X) @ Y for a in A])  # error-free measurements

    def left(steps: Float64) -> Float64:
        return residuals(A, B, X @ se3.exp(steps[:6]), Y @ se3.exp(steps[6:]), lever_m)

    J = np.array([(left(_STEP * e) - left(-_STEP * e)) / (2.0 * _STEP) for e in np.eye(12)]).T
    return np.asarray(np.linalg.solve(J.T @ J, J.T))


def _errors(gain: Float64, lever_m: float, sigma: Float64) -> tuple[float, float]:
    """Error of X in its worst direction, of the translation and of the rotation times the lever, for
    measurements with errors sigma (2,) in each component of these."""
    covariance = gain * np.repeat(sigma**2, gain.shape[1] // 2) @ gain.T
    shift, turn = (np.sqrt(np.linalg.eigvalsh(covariance[k, k])[-1]) for k in (slice(0, 3), slice(3, 6)))
    return float(shift), float(lever_m * turn)


def _more(A: Float64, found: HandEye, lever_m: float, axes: Float64) -> int | None:
    """How many poses to add: copies of one pose, rotated to either side about one axis after another, first
    the axis with the least rotation. None if `_MOST_MORE` are not enough."""
    turns = [sign * WANTED_RAD * axis for axis in axes[::-1] for sign in (1.0, -1.0)]
    one = A[len(A) // 2]
    for count in range(_MOST_MORE + 1):
        added = [one @ se3.make(se3.rotation_exp(turns[k % 6]), np.zeros(3)) for k in range(count)]
        if max(_errors(_gain(np.array([*A, *added]), found, lever_m), lever_m, _EQUAL)) <= 1.0:
            return count
    return None
