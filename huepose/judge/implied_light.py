"""The light that a pose implies, and the colours of the texture in that light.

Opponents are made of logarithms of linear values plus a floor (`colorpair.opponents.DARKEST`), because darker
values are noise. So light is an offset only where a colour is bright. In shade, a red brick is nearly black
and its opponents are small; a wrong pose whose texture has a dark part there agrees better than the right
one. Shading by distant lights is linear in the normal. Fitted to the image, it gives the brightness of the
texture at each sample, and so what the floor leaves of its colour. Only the strength of the light is fitted:
its colour is an offset, and lightness is compared without shading anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.colorpair.opponents import BYTES, DARKEST, LINEAR, OPPONENTS, SCALE, opponents
from huepose.geometry.arrays import Float, Float32, Float64, UInt8
from huepose.judge.color_correlation import SHADING_RIDGE
from huepose.judge.kernel_arrays import ModelArrays, RegionArrays, seen_samples, shown_range
from huepose.judge.terms import score_arrays
from huepose.support.jit import jit

SAMPLES = 400
"""Largest number of surface samples to which the light is fitted, and with which colours are compared in
it."""

LEAST_SEEN = 30
"""With fewer visible samples no light is fitted."""

COARSER = 1
"""Index of the colour scale at which the light is fitted: the coarser one has less noise."""

_NO_LIGHT = 1e-5
"""Added to products of linear values before their logarithm."""

_OF_OPPONENTS = np.linalg.inv(OPPONENTS.astype(np.float64)).T.astype(np.float32) / np.float32(SCALE)


@dataclass(frozen=True, eq=False)
class Light:
    """Strength of distant lights on a surface. slopes (4,): coefficients of its logarithm, for the constant 1
    and for the normal in object axes."""

    slopes: Float64

    def on(self, normals: Float) -> Float32:
        """Factors (N,) on the linear RGB of surfaces with normals (N, 3), object axes."""
        return np.asarray(np.exp(self.slopes[0] + normals @ self.slopes[1:]), np.float32)

    def falls_on(self, colors: Float32, normals: Float) -> Float32:
        """Opponents (..., N, 3) of a texture with normals (N, 3) in this light; lightness stays unchanged."""
        lit = opponents(_linear(colors) * self.on(normals)[:, None])
        lit[..., 0] = colors[..., 0]
        return lit

    def falls_on_picture(self, color: UInt8, normals_cam: Float32, R: Float64) -> UInt8:
        """Bytes (h, w, 3) of a rendered texture in this light. normals_cam (h, w, 3): camera axes, 0 where
        nothing is rendered; R (3, 3): rotation of the object."""
        return _lit(color, normals_cam, np.ascontiguousarray(R.T, np.float32), self.slopes)


@jit
def _lit(color: UInt8, normals_cam: Float32, R_obj_cam: Float32, slopes: Float64) -> UInt8:
    out = color.copy()
    for v in range(color.shape[0]):
        for u in range(color.shape[1]):
            x, y, z = normals_cam[v, u, 0], normals_cam[v, u, 1], normals_cam[v, u, 2]
            if x == 0.0 and y == 0.0 and z == 0.0:
                continue
            slope = slopes[0]
            for k in range(3):
                slope += slopes[k + 1] * (R_obj_cam[k, 0] * x + R_obj_cam[k, 1] * y + R_obj_cam[k, 2] * z)
            strength = np.exp(slope)
            for c in range(3):
                linear = min(LINEAR[color[v, u, c]] * strength, 1.0)
                out[v, u, c] = BYTES[int(np.sqrt(linear) * 1023.0 + 0.5)]
    return out


def implied_lights(model: ModelArrays, region: RegionArrays, poses: Float64) -> list[Light | None]:
    """For each of the poses T_cam_obj (K, 4, 4), the light in which the texture is most similar to the image;
    None where too few samples are visible."""
    return [_implied_light(model, region, np.ascontiguousarray(T, np.float64)) for T in poses]


def _implied_light(model: ModelArrays, region: RegionArrays, T: Float64) -> Light | None:
    seen = seen_samples(model, region, T, SAMPLES)
    if len(seen.which) < LEAST_SEEN:
        return None
    picture = _linear(region.colors[COARSER][seen.row, seen.column])
    texture = _linear(model.colors[COARSER][seen.which])
    # Bright texture shows how bright the light is; where the texture is dark, the image shows only haze.
    texture_power, product = (texture * texture).sum(1), (picture * texture).sum(1)
    brighter = np.log((product + _NO_LIGHT) / (texture_power + _NO_LIGHT))
    over_normals = np.column_stack([np.ones(len(seen.which)), model.normals[seen.which]])
    weighted = over_normals * seen.facing[:, None]
    ridge = SHADING_RIDGE * seen.facing.sum() * np.diag([0.0, 1.0, 1.0, 1.0])
    return Light(np.linalg.solve(weighted.T @ over_normals + ridge, weighted.T @ brighter))


def shading_gains(
    model: ModelArrays, region: RegionArrays, poses: Float64, lights: Sequence[Light | None]
) -> Float64:
    """By how much (K,) the colour agreement of poses T_cam_obj (K, 4, 4) rises if the texture is compared in
    the light of each pose, in units of the total; 0 without a light."""
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    gains = -score_arrays(model, region, poses, SAMPLES)[:, 4]
    for k, (T, light) in enumerate(zip(poses, lights, strict=True)):
        lit = model if light is None else _relit(model, light, T)
        gains[k] += score_arrays(lit, region, T[None], SAMPLES)[0, 4]
    return gains


def _relit(model: ModelArrays, light: Light, T_cam_obj: Float64) -> ModelArrays:
    """The model in a light: the colours of the first SAMPLES samples that are visible at a pose (4, 4) are
    changed."""
    first, last = shown_range(T_cam_obj, model, SAMPLES)
    shown = model.visible[first:last]
    colors = model.colors.copy()
    colors[:, shown] = light.falls_on(colors[:, shown], model.normals[shown])
    return model._replace(colors=colors)


def _linear(colors: Float32) -> Float32:
    """Linear RGB (..., 3) of opponents (..., 3)."""
    return np.maximum(np.exp(colors @ _OF_OPPONENTS) - np.float32(DARKEST), np.float32(0.0))
