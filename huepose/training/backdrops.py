"""What lies behind the objects in a detector's training pictures: tables, walls, prints and clouds."""

from __future__ import annotations

import numpy as np

from huepose.geometry import Camera, Mesh, se3
from huepose.geometry.arrays import UInt8
from huepose.rendering.render import Rendering, render
from huepose.scenes import prints
from huepose.scenes.room import sheet, table_top, wallpaper

Rng = np.random.Generator

_KEPT = 14
_RENEWED = 0.03
"""Chance that a picture brings a new one."""

_BEYOND_M = 30.0
"""Half the size of the wall behind everything, so that no line of sight misses it."""


class Backdrops:
    """A few surfaces, now and then replaced; each picture sees one or two of them in some turn."""

    def __init__(self, rng: Rng) -> None:
        self._rng = rng
        self._kept: list[Mesh] = []

    def draw(self, camera: Camera) -> Rendering:
        """A surface that fills the picture, in most cases with a second one before a part of it."""
        rng = self._rng
        wall = self._one()
        # One repeat of its print is seen at about this size; uv beyond 1 would be cut, so it is scaled.
        away = rng.uniform(0.4, 2.2)
        turn = se3.rotation_exp(rng.normal(0.0, 0.25, 3)) @ _facing(rng.uniform(0, 2 * np.pi))
        scene = [(wall, se3.make(turn, np.array([*rng.normal(0.0, 0.15, 2), away])))]
        if rng.random() < 0.7:
            pitch = np.radians(rng.uniform(25.0, 85.0))
            lying = se3.rotation_exp(np.array([pitch, 0.0, 0.0])) @ _facing(rng.uniform(0, 2 * np.pi))
            roll = se3.rotation_exp(np.array([0.0, 0.0, rng.normal(0.0, 0.3)]))
            at = np.array([rng.normal(0.0, 0.2), rng.uniform(0.0, 0.5), rng.uniform(0.5, 1.5)])
            scene.append((self._one(), se3.make(roll @ lying, at)))
        behind = np.array([0.0, 0.0, _BEYOND_M])
        scene.append((self._plain(), se3.make(_facing(0.0), behind)))
        return render(scene, camera, normals=True)

    def _one(self) -> Mesh:
        if len(self._kept) < _KEPT or self._rng.random() < _RENEWED:
            self._kept = [*self._kept[-_KEPT + 1 :], _surface(self._rng)]
        return self._kept[int(self._rng.integers(len(self._kept)))]

    def _plain(self) -> Mesh:
        colour = self._rng.integers(0, 256, 3).astype(np.uint8)
        texture: UInt8 = np.broadcast_to(colour, (2, 2, 3)).copy()
        return sheet(4 * _BEYOND_M, 4 * _BEYOND_M, texture)


def _facing(angle: float) -> np.ndarray:
    """A rotation (3, 3) that shows the printed side of a sheet to the camera, turned by an angle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [-s, -c, 0.0], [0.0, 0.0, -1.0]])


def _surface(rng: Rng) -> Mesh:
    """A sheet of a few decimetres to metres with a print of some kind."""
    kind = int(rng.integers(6))
    p = prints.palette(rng.uniform(), rng)
    side = 360
    if kind == 0:
        picture = table_top(rng, (600, 780))
    elif kind == 1:
        picture = wallpaper(rng, (480, 1000))
    elif kind == 2:
        picture = prints.picture(rng, side, side, p)
    elif kind == 3:
        arts = (prints.facts, prints.front("STORE", "mixed goods", "A1"), prints.blocks("misc"))
        picture = arts[int(rng.integers(len(arts)))](rng, side, side, p)
    elif kind == 4:
        cell = float(np.exp(rng.uniform(np.log(4.0), np.log(160.0))))
        picture = prints.mixed(p.base, p.light, prints.clouds(rng, side, side, cell, int(rng.integers(1, 5))))
    else:
        rough = rng.integers(0, 256, (int(rng.integers(4, 40)), int(rng.integers(4, 40)), 3))
        picture = np.kron(rough, np.ones((8, 8, 1))).astype(np.uint8)
    size = float(np.exp(rng.uniform(np.log(0.5), np.log(4.0))))
    return sheet(size, size * picture.shape[0] / picture.shape[1], picture)
