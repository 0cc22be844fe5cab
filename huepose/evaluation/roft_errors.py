"""The errors that ROFT reports of a track: RMSE of position and orientation, and of the two velocities.

Piga et al., *ROFT: Real-time Optical Flow-aided 6D Object Pose and Velocity Tracking* (RA-L 2022); in
centimetres and degrees. As there, a frame without a pose counts with the last one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64

FIGURES = ("rmse_cm", "rmse_deg", "rmse_cm_s", "rmse_deg_s")


def roft_figures(
    poses: Sequence[Float64 | None],
    truths: Sequence[Float64 | None],
    stamps_ns: Sequence[int],
    velocities: Sequence[Float64 | None] | None = None,
) -> dict[str, float | None]:
    """`rmse_cm`, `rmse_deg`, `rmse_cm_s`, `rmse_deg_s` of the frames of one track, in order.

    poses, truths: T_cam_obj (4, 4), None where there is none; velocities (6,): of the object's origin and of
    its turn, camera axes, per second, by default what the last two poses make it. The true velocity is that
    between the frames before and after. Frames before the first pose are left out. None where nothing counts.
    """
    held = _held(poses)
    stated = list(velocities) if velocities is not None else [None] * len(held)
    errors: list[tuple[float, float]] = []
    speed_errors: list[tuple[float, float]] = []
    for i, (pose, truth) in enumerate(zip(held, truths, strict=True)):
        if pose is None or truth is None:
            continue
        errors.append(_lengths(se3.difference(truth, pose)))
        true_speed = _speed(truths, stamps_ns, i - 1, i + 1)
        speed = stated[i] if stated[i] is not None else _speed(held, stamps_ns, i - 1, i)
        if true_speed is not None and speed is not None:
            speed_errors.append(_lengths(np.asarray(speed) - true_speed))
    values = [*_rmse(errors), *_rmse(speed_errors)]
    return dict(zip(FIGURES, values, strict=True))


def _held(poses: Sequence[Float64 | None]) -> list[Float64 | None]:
    last, held = None, []
    for pose in poses:
        last = pose if pose is not None else last
        held.append(last)
    return held


def _speed(
    poses: Sequence[Float64 | None], stamps_ns: Sequence[int], before: int, after: int
) -> Float64 | None:
    """Mean velocity (6,) from one frame to another, None where one of them has no pose."""
    if before < 0 or after >= len(poses):
        return None
    start, end = poses[before], poses[after]
    if start is None or end is None:
        return None
    return np.asarray(se3.difference(start, end) / (1e-9 * (stamps_ns[after] - stamps_ns[before])))


def _lengths(delta: Float64) -> tuple[float, float]:
    """Centimetres and degrees of a difference (6,)."""
    return 100.0 * float(np.linalg.norm(delta[:3])), float(np.degrees(np.linalg.norm(delta[3:])))


def _rmse(pairs: Sequence[tuple[float, float]]) -> list[float | None]:
    if not pairs:
        return [None, None]
    return [float(v) for v in np.sqrt((np.array(pairs) ** 2).mean(0))]
