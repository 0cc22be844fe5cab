"""The light that a pose implies, and what it leaves of a texture's colours.

Opponents are of logarithms of light plus a floor (`colorpair.opponents.DARKEST`), since what is darker is
noise. So light is an offset only where a colour is bright: in the shade a red brick is nearly black, its
opponents are small, and a pose whose texture has a dark part there agrees better than the right one. Shading
by distant lights is linear in the normal; fitted to what is seen, it says how bright the texture is at each
sample, and so what the floor leaves of its colour. Only the strength of the light is fitted: its own colour
is an offset, and lightness is compared without shading anyhow.
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
"""Most surface samples to which the light is fitted, and by which colours are compared in it."""

LEAST_SEEN = 30
"""Fewer samples that are seen tell no light."""

COARSER = 1
"""Of the scales of colours, that at which the light is fitted: less noise."""

_NO_LIGHT = 1e-5
"""Added to products of linear values before their logarithm."""

_OF_OPPONENTS = np.linalg.inv(OPPONENTS.astype(np.float64)).T.astype(np.float32) / np.float32(SCALE)


@dataclass(frozen=True, eq=False)
class Light:
    """How strongly distant lamps shine on a surface. slopes (4,): of the logarithm over 1 and the normal in
    object axes."""

    slopes: Float64

    def on(self, normals: Float) -> Float32:
        """Factors (N,) of linear RGB where a surface has normals (N, 3), object axes."""
        return np.asarray(np.exp(self.slopes[0] + normals @ self.slopes[1:]), np.float32)

    def falls_on(self, colors: Float32, normals: Float) -> Float32:
        """Opponents (..., N, 3) of a texture with normals (N, 3) as they look in this light, but for their
        lightness, which stays."""
        lit = opponents(_linear(colors) * self.on(normals)[:, None])
        lit[..., 0] = colors[..., 0]
        return lit

    def falls_on_picture(self, color: UInt8, normals_cam: Float32, R: Float64) -> UInt8:
        """Bytes (h, w, 3) of a drawn texture as it looks in this light. normals_cam (h, w, 3): camera axes,
        0 where nothing is; R (3, 3): rotation of the object."""
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
    """The light in which the texture looks most as in the picture, at each of the poses T_cam_obj (K, 4, 4);
    None where too few samples are seen."""
    return [_implied_light(model, region, np.ascontiguousarray(T, np.float64)) for T in poses]


def _implied_light(model: ModelArrays, region: RegionArrays, T: Float64) -> Light | None:
    seen = seen_samples(model, region, T, SAMPLES)
    if len(seen.which) < LEAST_SEEN:
        return None
    picture = _linear(region.colors[COARSER][seen.row, seen.column])
    texture = _linear(model.colors[COARSER][seen.which])
    # What is bright in the texture says how bright the light is; what is dark in it is haze in the picture.
    known, shown_of_it = (texture * texture).sum(1), (picture * texture).sum(1)
    brighter = np.log((shown_of_it + _NO_LIGHT) / (known + _NO_LIGHT))
    over_normals = np.column_stack([np.ones(len(seen.which)), model.normals[seen.which]])
    weighted = over_normals * seen.facing[:, None]
    ridge = SHADING_RIDGE * seen.facing.sum() * np.diag([0.0, 1.0, 1.0, 1.0])
    return Light(np.linalg.solve(weighted.T @ over_normals + ridge, weighted.T @ brighter))


def shading_gains(
    model: ModelArrays, region: RegionArrays, poses: Float64, lights: Sequence[Light | None]
) -> Float64:
    """By how much more (K,) the colours of poses T_cam_obj (K, 4, 4) agree where the texture is seen in its
    light, in units of the total; 0 without a light."""
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    gains = -score_arrays(model, region, poses, SAMPLES)[:, 4]
    for k, (T, light) in enumerate(zip(poses, lights, strict=True)):
        lit = model if light is None else _relit(model, light, T)
        gains[k] += score_arrays(lit, region, T[None], SAMPLES)[0, 4]
    return gains


def _relit(model: ModelArrays, light: Light, T_cam_obj: Float64) -> ModelArrays:
    """A model with the colours that the first SAMPLES samples that a pose (4, 4) shows have in a light."""
    first, last = shown_range(T_cam_obj, model, SAMPLES)
    shown = model.visible[first:last]
    colors = model.colors.copy()
    colors[:, shown] = light.falls_on(colors[:, shown], model.normals[shown])
    return model._replace(colors=colors)


def _linear(colors: Float32) -> Float32:
    """Linear RGB (..., 3) of opponents (..., 3)."""
    return np.maximum(np.exp(colors @ _OF_OPPONENTS) - np.float32(DARKEST), np.float32(0.0))
