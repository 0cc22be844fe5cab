"""Symmetries of an object as a list of rotations: T_cam_obj and T_cam_obj @ rotation look the same.

BOP's convention (bop_toolkit, misc.get_symmetry_transformations): discrete symmetries are 4x4 transforms;
continuous ones are an axis and an offset, and are sampled. Every sample is applied after every discrete
one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Float64


def rotation_about(axis: Float, angle_rad: float, offset_m: Float) -> Float64:
    """Rotation (4, 4) by an angle about the line through `offset_m` (3,) along `axis` (3,)."""
    a = np.asarray(axis, np.float64)
    R = se3.rotation_exp(a / np.linalg.norm(a) * angle_rad)
    offset = np.asarray(offset_m, np.float64)
    return se3.make(R, offset - R @ offset)


def nearest_alike(T_cam_obj: Float64, equivalents: Float64, T_near: Float64) -> Float64:
    """Of the poses T_cam_obj @ equivalents (S, 4, 4), which look the same, the one (4, 4) whose rotation is
    nearest to that of T_near."""
    poses = T_cam_obj @ equivalents
    return np.asarray(poses[np.einsum("ij,kij->k", T_near[:3, :3], poses[:, :3, :3]).argmax()])


def sampled(entry: Mapping[str, Any], step_rad: float, unit_m: float = 0.001) -> Float64:
    """Rotations (S, 4, 4), identity first, of one object's entry in `models_info.json`.

    step_rad: the largest angle between neighbouring samples of a continuous symmetry; unit_m: metres per
    unit of the file (BOP writes millimetres).
    """
    discrete = [np.eye(4)]
    for row in entry.get("symmetries_discrete", []):
        T = np.array(row, np.float64).reshape(4, 4)
        T[:3, 3] *= unit_m
        discrete.append(se3.orthonormalised(T))
    continuous = [np.eye(4)]
    for symmetry in entry.get("symmetries_continuous", []):
        steps = int(np.ceil(2 * np.pi / step_rad))
        offset = np.array(symmetry.get("offset", [0, 0, 0]), np.float64) * unit_m
        continuous += [
            rotation_about(symmetry["axis"], 2 * np.pi * k / steps, offset) for k in range(1, steps)
        ]
    return np.stack([c @ d for d in discrete for c in continuous])
