"""The textured demo objects, made by code: a box, a can, a bottle, a bracket and a tray.

Closed meshes of one to six thousand triangles. All charts have the same number of pixels per metre and are
packed into one texture.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from huepose.geometry.arrays import Float64, Rng, UInt8
from huepose.geometry.mesh import Mesh
from huepose.geometry.shelves import on_shelves
from huepose.scenes import textures
from huepose.scenes.charts import OPEN_TOP, Chart, blocks, revolved
from huepose.scenes.textures import Art, Palette

TEXTURE_PX = 1024
GAP_PX = 8  # between charts; each chart's texture extends over half of it


def demo_objects(seed: int = 0) -> dict[str, Mesh]:
    """Five objects of 10 to 19 cm in metres, z up, the origin at the centre of the bounding box.

    The same seed gives the same pixels; another seed gives other colours, pictures and texts.
    """
    rng = np.random.default_rng([seed, 20])
    hues = (rng.uniform() + np.array([0.0, 0.42, 0.2, 0.63, 0.83])) % 1.0
    colours = [textures.palette(float(hue), rng) for hue in hues]
    built = (("tea_box", tea_box), ("soup_can", soup_can), ("juice_bottle", juice_bottle),
             ("corner_bracket", corner_bracket), ("parts_tray", parts_tray))  # fmt: skip
    return {name: build(colour, rng) for (name, build), colour in zip(built, colours, strict=True)}


def tea_box(p: Palette, rng: Rng) -> Mesh:
    """A box of 9 x 6 x 15 cm, every side printed differently."""
    charts = blocks([-0.045, 0.045], [-0.03, 0.03], [-0.075, 0.075], np.ones((1, 1, 1), bool))
    arts = [
        textures.blocks("TEA TIME"),
        textures.blocks("40 BAGS"),
        textures.front("EVENING", "herbal tea", "NEW"),
        textures.facts,
        textures.blocks("LOT 2719"),
        textures.front("OPEN", "tear here", "TOP"),
    ]
    return printed(charts, arts, p, rng)


def soup_can(p: Palette, rng: Rng) -> Mesh:
    """A can of 7.4 cm across and 11 cm tall, with rims."""
    r, h = 0.037, 0.055
    bottom = [(0.0, -h), (0.018, -h), (r - 0.002, -h), (r, -h + 0.002)]
    side = [(r, z) for z in np.linspace(-h + 0.002, h - 0.002, 10)]
    top = [(r, h - 0.002), (r - 0.002, h), (r - 0.004, h - 0.003), (0.018, h - 0.003), (0.0, h - 0.003)]
    arts = [textures.lid("BASE"), textures.wrapper("TOMATO", "soup", "HOT"), textures.lid("PULL")]
    return printed(revolved([bottom, side, top]), arts, p, rng)


def juice_bottle(p: Palette, rng: Rng) -> Mesh:
    """A bottle of 7 cm across and 19 cm tall with a waist, a neck and a cap."""
    z = np.linspace(0.0, 1.0, 9)
    body = [(0.034 - 0.004 * np.sin(np.pi * s) ** 2, -0.092 + 0.1 * s) for s in z]
    shoulder = [(0.014 + 0.02 * np.cos(0.5 * np.pi * s), 0.008 + 0.052 * s) for s in z[1:]]
    neck = [(0.014, 0.068), (0.018, 0.0685), (0.018, 0.09)]
    bottom = [(0.0, -0.095), (0.016, -0.095), (0.031, -0.095), body[0]]
    cap = [neck[-1], (0.016, 0.095), (0.008, 0.095), (0.0, 0.095)]
    arts = [textures.lid("PET 1"), textures.wrapper("CITRUS", "fresh juice", "1+1"), textures.lid("TURN")]
    return printed(revolved([bottom, body + shoulder + neck, cap]), arts, p, rng)


def corner_bracket(p: Palette, rng: Rng) -> Mesh:
    """An L of 13 x 7 x 10 cm and 2.6 cm thick, painted and labelled."""
    charts = blocks(
        [-0.065, -0.039, 0.065], [-0.035, 0.035], [-0.05, -0.024, 0.05], np.array([[[1, 1]], [[1, 0]]], bool)
    )
    words = ("LEFT 01", "INSIDE", "TIP 35", "FRONT A", "REAR B7", "BASE L-120", "SHELF", "TOP")
    return printed(charts, [textures.sticker(word, k) for k, word in enumerate(words)], p, rng)


def parts_tray(p: Palette, rng: Rng) -> Mesh:
    """An open box of 15 x 11 x 7 cm with walls of 9 mm."""
    x, y, z, wall = 0.075, 0.055, 0.035, 0.009
    charts = blocks([-x, wall - x, x - wall, x], [-y, wall - y, y - wall, y], [-z, wall - z, z], OPEN_TOP)
    words = (
        "WEST",
        "M4 x 12",
        "NUTS",
        "EAST 9",
        "BOX 14",
        "inner",
        "SCREWS",
        "REAR",
        "UNDER",
        "FLOOR 5",
        "RIM",
    )
    return printed(charts, [textures.sticker(word, k) for k, word in enumerate(words)], p, rng)


def printed(
    charts: Sequence[Chart], arts: Sequence[Art], p: Palette, rng: Rng, texture_px: int = TEXTURE_PX
) -> Mesh:
    """The mesh of the charts, each printed with its own art, all in one square texture."""
    sizes = np.array([chart.size for chart in charts])
    density, places = _packed(sizes, texture_px)
    texture = np.zeros((texture_px, texture_px, 3), np.uint8)
    half = GAP_PX // 2
    uv = []
    for chart, art, (x, y) in zip(charts, arts, places, strict=True):
        width, height = (max(8, int(s * density)) for s in chart.size)
        picture: UInt8 = cv2.copyMakeBorder(
            art(rng, height, width, p), half, half, half, half, cv2.BORDER_REPLICATE
        ).astype(np.uint8)
        texture[y : y + height + 2 * half, x : x + width + 2 * half] = picture
        scale = np.array([width, height]) / chart.size
        uv.append((chart.flat * scale + (x + half, y + half)) / texture_px)
    corners = np.concatenate([chart.corners for chart in charts]).reshape(-1, 3)
    vertices, index = np.unique(np.round(corners, 7) + 0.0, axis=0, return_inverse=True)
    return Mesh(
        vertices.astype(np.float32),
        index.reshape(-1, 3).astype(np.int32),
        np.concatenate(uv).astype(np.float32),
        texture,
    )


def _packed(sizes: Float64, texture_px: int) -> tuple[float, list[tuple[int, int]]]:
    """The most pixels per metre at which charts of these sizes (N, 2) fit into the texture in rows, and their
    top-left corners in px."""

    def packed(density: float) -> tuple[list[tuple[int, int]], bool]:
        pixels = np.maximum(8, (sizes * density).astype(int)) + GAP_PX
        places, width, height = on_shelves([(int(h), int(w)) for w, h in pixels], texture_px)
        return places, max(width, height) <= texture_px

    low, high = 100.0, 8000.0
    while high - low > 10.0:
        middle = (low + high) / 2
        low, high = (middle, high) if packed(middle)[1] else (low, middle)
    return low, packed(low)[0]
