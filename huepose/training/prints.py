"""What random objects for training share: prints, colours, and their size."""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Rng
from huepose.geometry.mesh import Mesh
from huepose.scenes import textures
from huepose.scenes.textures import Art, Colour, Palette

LETTERS = tuple("ABCDEFGHIJKLMNOPRSTUVWXYZ0123456789")


def random_art(rng: np.random.Generator) -> Art:
    """A random print for one side of an object."""
    word, other = ("".join(rng.choice(LETTERS, int(rng.integers(3, 9)))) for _ in range(2))
    arts = (
        *(textures.blocks(word), textures.front(word, other, word[:2]), textures.facts, textures.picture),
        *(textures.sticker(word, int(rng.integers(4))), textures.lid(word), textures.painted),
    )
    return arts[int(rng.integers(len(arts)))]


def random_palette(rng: Rng) -> Palette:
    """Any colours; every third time the base is a grey between black and white."""
    colours: list[Colour] = [_colour(*rng.integers(10, 250, 3)) for _ in range(5)]
    if rng.random() < 0.35:
        grey = int(rng.choice([rng.integers(12, 50), rng.integers(60, 180), rng.integers(200, 250)]))
        colours[0] = grey, grey, grey
    return Palette(*colours)


def _colour(red: int, green: int, blue: int) -> Colour:
    return int(red), int(green), int(blue)


def sized(mesh: Mesh, diameter_m: float) -> Mesh:
    """The mesh about the origin, with a bounding box whose diagonal is `diameter_m` metres long."""
    v = mesh.vertices - (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
    v *= diameter_m / np.linalg.norm(v.max(0) - v.min(0))
    return Mesh(v.astype(np.float32), mesh.faces, mesh.uv, mesh.texture)
