"""A room around a table, with its own surfaces."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float, Rng, UInt8
from huepose.scenes.heap import open_box
from huepose.scenes.room import Placed, sheet
from huepose.scenes.textures import clouds


def surface(rng: Rng, pixels: int = 512) -> UInt8:
    """The texture of a surface: plain, wooden, stone or checked."""
    a, b = (rng.uniform(30, 245, 3).astype(np.float32) for _ in range(2))
    out: Float
    kind = rng.choice(["plain", "wood", "stone", "checks"], p=[0.35, 0.3, 0.2, 0.15])
    share = clouds(rng, pixels, pixels, pixels / 4, 5)[..., None]
    if kind == "plain":
        out = a + 12.0 * (share - 0.5)
    elif kind == "wood":
        short = clouds(rng, pixels // 16, pixels, pixels / 16, 5)
        grain = cv2.resize(short, (pixels, pixels), interpolation=cv2.INTER_CUBIC)[..., None]
        out = rng.uniform(90, 220) * np.array([1.0, 0.72, 0.5]) * (0.75 + 0.4 * grain)
    elif kind == "stone":
        out = (0.3 * a + 0.1 * b + 90.0) * (0.7 + 0.5 * share)
    else:
        cell = np.arange(pixels) // int(rng.integers(8, 128))
        out = np.where(((cell[:, None] + cell) % 2)[..., None] == 1, a, b) * (0.9 + 0.2 * share)
    return np.clip(out, 0, 255).astype(np.uint8)


def room(rng: Rng) -> list[Placed]:
    """A table at z = 0, floor, walls, ceiling, and open boxes on the floor and in the air."""
    wide, deep = 2.0 * rng.uniform(0.4, 0.8, 2)
    table = sheet(wide, deep, surface(rng))
    turn = se3.rotation_exp(np.array([0, 0, rng.uniform(0, 2 * np.pi)]))
    out: list[Placed] = [(table, se3.make(turn, np.zeros(3)))]
    floor, ceiling = sheet(8, 8, surface(rng)), sheet(8, 8, surface(rng))
    out.append((floor, se3.make(np.eye(3), np.array([0, 0, -0.75]))))
    out.append((ceiling, se3.make(se3.rotation_exp(np.array([np.pi, 0, 0])), np.array([0, 0, 1.9]))))
    upright = se3.rotation_exp(np.array([np.pi / 2, 0, 0]))
    for k in range(4):
        about = se3.rotation_exp(np.array([0, 0, k * np.pi / 2])) @ turn
        wall = sheet(8, 4, surface(rng))
        out.append((wall, se3.make(about @ upright, about @ np.array([0, rng.uniform(1.2, 3.2), 0.5]))))
    for _ in range(int(rng.integers(2, 9))):
        angle, away, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 2.2), rng.uniform(0.16, 0.8)
        height = -0.75 + size / 2 if rng.uniform() < 0.6 else rng.uniform(-0.3, 0.4)
        place = np.array([away * np.cos(angle), away * np.sin(angle), height])
        chest = open_box(0.15, 0.2, rng)
        out.append((replace(chest, vertices=chest.vertices * np.float32(5.0 * size)), se3.make(turn, place)))
    return out
