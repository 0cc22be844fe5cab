"""Moving light: a key light with a soft-edged shadow, sky light, tint and exposure, in linear light.

Lambert's law on smooth normals, and a weak highlight on labelled objects. Everything is smooth in time, also
where the loop closes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import Float, Float32, Float64, Rng, UInt8
from huepose.rendering import render
from huepose.scenes.motion import UP_ROOM, Timing, positions
from huepose.support.jit import jit

TO_LINEAR: Float32 = ((np.arange(256) / 255.0) ** 2.2).astype(np.float32)
_SHADOW_CAMERA = Camera(1520.0, 1520.0, 511.5, 511.5, 1024, 1024)
_SHADOW_DISTANCE_M = 2.6
_SCENE_CENTRE_ROOM = np.array([0.0, 0.0, 0.95])


@dataclass(frozen=True, eq=False)
class Light:
    """towards_room (3,): unit vector from the scene to the key light; key, sky: strengths; gain (3,):
    exposure and tint of R, G, B; gloss: strength of the highlight."""

    towards_room: Float64
    key: float
    sky: float
    gain: Float64
    gloss: float = 0.15


def lights(timing: Timing, rng: Rng) -> list[Light]:
    """A light for each frame of a loop: the key light moves overhead, tint and exposure drift."""
    n = max(4, round(timing.length_s / 1.6))
    when = np.arange(len(timing.phase)) / len(timing.phase)
    wander = positions(np.clip(rng.normal(0, 1, (n, 6)), -1.8, 1.8), when)
    side = rng.choice([-1.0, 1.0])
    return [_light(row, side) for row in wander]


def random_light(rng: Rng) -> Light:
    """One random light with the ranges of `lights`."""
    return _light(rng.uniform(-1.2, 1.2, 6), rng.choice([-1.0, 1.0]))


def _light(x: Float, side: float) -> Light:
    towards = UP_ROOM + np.array([0.55 * side + 0.45 * x[0], 0.0, -0.35 + 0.3 * x[1]])
    tint = 1.0 + 0.14 * np.array([x[2], -0.2 * x[2] + 0.25 * x[3], -x[2]])
    exposure = 2.0 ** (0.4 * float(x[4]))
    return Light(
        towards / np.linalg.norm(towards),
        0.72 + 0.12 * float(x[5]),
        0.42,
        np.clip(exposure * tint, 0.45, 1.9),
    )


def shadow_map(scene: Sequence[tuple[Mesh, Float]], light: Light) -> tuple[Float32, Float64]:
    """Shadow map of the key light: depth (H, W) m, and T_light_room. scene: meshes with T_room_mesh."""
    z = -light.towards_room
    x = np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    T_light_room = se3.make(R, -R @ (_SCENE_CENTRE_ROOM - _SHADOW_DISTANCE_M * z))
    placed = [(mesh, T_light_room @ T) for mesh, T in scene]
    return render(placed, _SHADOW_CAMERA, color=False).depth, T_light_room


def shine(
    color: UInt8,
    normals_cam: Float32,
    depth: Float32,
    glossy: np.ndarray,
    camera: Camera,
    T_cam_room: Float64,
    light: Light,
    shadow: tuple[Float32, Float64],
    total: Float32,
) -> None:
    """Add the light that each pixel reflects to `total` (H, W, 3), linear, 1 = white.

    color (H, W, 3): uint8 sRGB of the surface; glossy (H, W): uint8, where there may be a highlight.
    """
    T_light_cam = shadow[1] @ se3.inverse(T_cam_room)
    R = T_cam_room[:3, :3]
    _shine(
        color,
        normals_cam,
        depth,
        glossy,
        (camera.fx, camera.fy, camera.cx, camera.cy),
        R @ light.towards_room,
        R @ UP_ROOM,
        light.key,
        light.sky,
        light.gain,
        light.gloss,
        T_light_cam,
        shadow[0],
        (_SHADOW_CAMERA.fx, _SHADOW_CAMERA.cx),
        TO_LINEAR,
        total,
    )


@jit
def _shine(
    color: UInt8,
    normals: Float32,
    depth: Float32,
    glossy: UInt8,
    intrinsics: tuple[float, float, float, float],
    towards: Float64,
    up: Float64,
    key: float,
    sky: float,
    gain: Float64,
    gloss: float,
    T_light_cam: Float64,
    shadow: Float32,
    shadow_camera: tuple[float, float],
    to_linear: Float32,
    total: Float32,
) -> None:
    fx, fy, cx, cy = intrinsics
    focal, middle = shadow_camera
    T, size = T_light_cam, shadow.shape[0]
    for row in range(depth.shape[0]):
        y = (row - cy) / fy
        for column in range(depth.shape[1]):
            z = np.float64(depth[row, column])
            if z <= 0:
                continue
            x = (column - cx) / fx
            n0, n1, n2 = normals[row, column, 0], normals[row, column, 1], normals[row, column, 2]
            facing = n0 * towards[0] + n1 * towards[1] + n2 * towards[2]
            above = n0 * up[0] + n1 * up[1] + n2 * up[2]
            highlight = 0.0
            lit = 0.0
            if facing > 0:
                # The point is moved off the surface along its normal, so that it does not shade itself.
                p0, p1, p2 = x * z + 0.004 * n0, y * z + 0.004 * n1, z + 0.004 * n2
                a = T[0, 0] * p0 + T[0, 1] * p1 + T[0, 2] * p2 + T[0, 3]
                b = T[1, 0] * p0 + T[1, 1] * p1 + T[1, 2] * p2 + T[1, 3]
                c = T[2, 0] * p0 + T[2, 1] * p1 + T[2, 2] * p2 + T[2, 3]
                u, v = focal * a / c + middle, focal * b / c + middle
                if 1 <= u < size - 2 and 1 <= v < size - 2:
                    i, j = int(v), int(u)
                    dv, du = v - i, u - j
                    far = c - 0.004
                    s00, s01 = shadow[i, j], shadow[i, j + 1]
                    s10, s11 = shadow[i + 1, j], shadow[i + 1, j + 1]
                    lit = (1 - dv) * (
                        (1 - du) * (s00 == 0 or s00 > far) + du * (s01 == 0 or s01 > far)
                    ) + dv * ((1 - du) * (s10 == 0 or s10 > far) + du * (s11 == 0 or s11 > far))
                else:
                    lit = 1.0
                if glossy[row, column]:
                    length = np.sqrt(x * x + y * y + 1.0)
                    h0, h1, h2 = towards[0] - x / length, towards[1] - y / length, towards[2] - 1.0 / length
                    cos = (n0 * h0 + n1 * h1 + n2 * h2) / np.sqrt(h0 * h0 + h1 * h1 + h2 * h2)
                    if cos > 0:
                        cos = cos * cos
                        cos = cos * cos
                        cos = cos * cos
                        cos = cos * cos
                        highlight = gloss * cos * cos * lit
            strength = key * max(facing, 0.0) * lit + sky * (0.65 + 0.35 * above)
            for k in range(3):
                total[row, column, k] += gain[k] * (to_linear[color[row, column, k]] * strength + highlight)
