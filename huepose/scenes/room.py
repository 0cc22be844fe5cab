"""The surroundings in the rendered scenes: a table, a wall, clutter on the table, a bar that passes by.

Poses are in the frame `room`, as in `scenes.motion`.
"""

from __future__ import annotations

import cv2
import numpy as np

from huepose.geometry import se3
from huepose.geometry.arrays import Float64, Rng, UInt8
from huepose.geometry.mesh import Mesh
from huepose.scenes import textures
from huepose.scenes.charts import Chart, blocks, revolved
from huepose.scenes.motion import AHEAD_ROOM, TABLE_M, UP_ROOM, upright
from huepose.scenes.shapes import printed
from huepose.scenes.textures import Palette

Placed = tuple[Mesh, Float64]

TABLE_SIZE_M, WALL_SIZE_M = (2.6, 2.0), (5.0, 2.4)


def sheet(width_m: float, height_m: float, texture: UInt8) -> Mesh:
    """A rectangle in z = 0 centred at the origin; its texture is upright when seen from +z with y up."""
    x, y = width_m / 2, height_m / 2
    vertices = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    return Mesh(vertices, faces, uv[faces], texture)


def room(rng: Rng, n_clutter: int = 11) -> list[Placed]:
    """Table, wall and clutter with their poses T_room_mesh (4, 4)."""
    below = -TABLE_M * UP_ROOM  # the point of the table vertically below the camera
    lying = se3.make(upright(0.0), below + 0.95 * AHEAD_ROOM)
    wall_turn = upright(0.0) @ se3.rotation_exp(np.array([np.pi / 2, 0, 0]))
    standing = se3.make(wall_turn, below + 2.0 * AHEAD_ROOM + 0.6 * UP_ROOM)
    placed: list[Placed] = [
        (sheet(*TABLE_SIZE_M, table_top(rng)), lying),
        (sheet(*WALL_SIZE_M, wallpaper(rng)), standing),
    ]
    spots: list[Float64] = []
    for _ in range(2000):
        if len(spots) == n_clutter:
            break
        spot = np.array([rng.uniform(-0.85, 0.85), rng.uniform(1.12, 1.75)])
        if all(np.linalg.norm(spot - other) > 0.17 for other in spots):
            spots.append(spot)
            mesh = clutter(rng)
            height = -float(mesh.vertices[:, 2].min())
            place = below + spot[0] * np.array([1.0, 0, 0]) + spot[1] * AHEAD_ROOM + height * UP_ROOM
            placed.append((mesh, se3.make(upright(rng.uniform(0, 2 * np.pi)), place)))
    return placed


def table_top(rng: Rng, pixels: tuple[int, int] = (1200, 1560)) -> UInt8:
    """A wooden table with a runner cloth and a few coasters and notes on it."""
    height, width = pixels
    p = textures.palette(rng.uniform(0.03, 0.12), rng)
    wood = tuple(int(c) for c in rng.uniform(0.75, 1.15) * np.array([150, 112, 78]))
    dark = tuple(int(0.62 * c) for c in wood)
    grain = cv2.resize(textures.clouds(rng, height, 90, 14, 3), (width, height)).astype(np.float32)
    image = textures.mixed((wood[0], wood[1], wood[2]), (dark[0], dark[1], dark[2]), grain)
    for k in range(1, 7):
        cv2.line(image, (0, k * height // 7), (width, k * height // 7), dark, 3, cv2.LINE_AA)
    cloth = textures.palette(rng.uniform(), rng)
    low, high = round(rng.uniform(0.28, 0.36) * width), round(rng.uniform(0.6, 0.68) * width)
    weave = textures.mixed(
        cloth.light, cloth.base, 0.1 + 0.12 * textures.clouds(rng, height, high - low, 160, 6)
    )
    for at, breadth, colour in (
        (0.06, 0.05, cloth.base),
        (0.14, 0.015, cloth.accent),
        (0.88, 0.07, cloth.base),
    ):
        weave[:, round(at * (high - low)) : round((at + breadth) * (high - low))] = colour
    for _ in range(5):
        spot = (int(rng.uniform(0.25, 0.8) * (high - low)), int(rng.uniform(0.1, 0.9) * height))
        cv2.circle(weave, spot, 34, cloth.accent, -1, cv2.LINE_AA)
        cv2.circle(weave, spot, 20, cloth.light, -1, cv2.LINE_AA)
    image[:, low:high] = weave
    for _ in range(12):
        note = textures.palette(rng.uniform(), rng)
        h, w = (int(rng.integers(60, 110)) for _ in range(2))
        x, y = int(rng.integers(0, width - w)), int(rng.integers(0, height - h))
        image[y : y + h, x : x + w] = textures.plain(h, w, note.light)
        textures.paragraph(image[y : y + h, x : x + w], rng, (0.1, 0.1, 0.8, 0.8), 5, p.dark)
    return image


def wallpaper(rng: Rng, pixels: tuple[int, int] = (720, 1500)) -> UInt8:
    """A painted wall with a skirting, pictures and a shelf edge."""
    height, width = pixels
    p = textures.palette(rng.uniform(), rng)
    image = textures.mixed(p.light, p.base, 0.25 + 0.25 * textures.clouds(rng, height, width, width / 5, 5))
    image[round(0.93 * height) :] = p.dark
    for k in range(7):
        h, w = int(rng.integers(150, 320)), int(rng.integers(130, 200))
        x = min(round((k + rng.uniform(0.05, 0.3)) * width / 7), width - w)
        y = int(rng.integers(0, height - h - 60))
        q = textures.palette(rng.uniform(), rng)
        image[y : y + h, x : x + w] = textures.plain(h, w, q.dark)
        image[y + 8 : y + h - 8, x + 8 : x + w - 8] = textures.picture(rng, h - 16, w - 16, q)
    return image


def clutter(rng: Rng) -> Mesh:
    """A mesh of 5 to 16 cm that is none of the objects: plain or printed; box, ball, cup or step."""
    kind = int(rng.integers(4))
    p = textures.palette(rng.uniform(), rng)
    art = [textures.painted, textures.sticker("STORE 3", int(rng.integers(4))), textures.blocks("misc")][
        int(rng.integers(3))
    ]
    if kind == 0:
        x, y, z = rng.uniform(0.025, 0.06), rng.uniform(0.025, 0.05), rng.uniform(0.02, 0.075)
        charts = blocks([-x, x], [-y, y], [-z, z], np.ones((1, 1, 1), bool), 0.05)
    elif kind == 1:
        charts = ball(rng.uniform(0.03, 0.055))
    elif kind == 2:
        r, h = rng.uniform(0.028, 0.045), rng.uniform(0.035, 0.06)
        bottom, outside = [(0.0, -h), (0.8 * r, -h)], [(0.8 * r, -h), (r, h)]
        inside = [(r, h), (0.88 * r, h), (0.7 * r, -0.9 * h), (0.0, -0.9 * h)]
        charts = revolved([bottom, outside, inside], 32)
    else:
        a, z = rng.uniform(0.03, 0.06), rng.uniform(0.02, 0.04)
        charts = blocks([-a, 0, a], [-0.04, 0.04], [-z, 0, z], np.array([[[1, 1]], [[1, 0]]], bool), 0.05)
    return printed(charts, [art if k % 2 == 0 else textures.painted for k in range(len(charts))], p, rng, 256)


def bar(rng: Rng) -> Mesh:
    """A stick of 3 x 2 x 60 cm along y, painted in bands. It passes in front of the objects."""
    p = textures.palette(rng.uniform(), rng)
    charts = blocks([-0.015, 0.015], [-0.3, 0.3], [-0.01, 0.01], np.ones((1, 1, 1), bool), 0.1)
    return printed(charts, [_bands] * len(charts), p, rng, 512)


def ball(radius: float) -> list[Chart]:
    """A ball in three charts."""
    angle = np.radians(np.arange(-90, 91, 10))
    arc = [(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in angle]
    arc[0], arc[-1] = (0.0, -radius), (0.0, radius)
    return revolved([arc[:4], arc[3:-3], arc[-4:]], 32)


def _bands(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    image = textures.painted(rng, height, width, p)
    image[: height // 5], image[-height // 5 :] = p.dark, p.spot
    return image
