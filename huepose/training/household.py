"""Random household objects for training: bowls, mugs, tools made of bars, fruit; painted, some with a print.

The packages and superquadrics of `shapes` are textured and mostly convex. On real tables there are also
hollow and thin objects, and objects of one colour, black or white. All random objects share prints and
colours.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float64, Rng
from huepose.geometry.mesh import Mesh
from huepose.scenes import textures
from huepose.scenes.charts import Chart, blocks, flattened, grid_triangles, revolved
from huepose.scenes.shapes import printed
from huepose.scenes.textures import Art, Colour, Palette

TEXTURE_PX = 768


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


def household_object(rng: Rng, diameter_m: float) -> Mesh:
    """A closed, textured mesh about the origin whose bounding box's diagonal measures `diameter_m` metres."""
    charts = (_bowl, _mug, _bars, _flat_tool, _fruit)[int(rng.integers(5))](rng)
    base = random_palette(rng)
    printed_share = 0.25 if rng.random() < 0.5 else 0.0
    arts = [_art(rng, base, rng.random() < printed_share) for _ in charts]
    return sized(printed(charts, arts, base, rng, TEXTURE_PX), diameter_m)


def _art(rng: Rng, base: Palette, other: bool) -> Art:
    """A print if `other`, else paint, sometimes in another colour."""
    own = random_palette(rng) if other or rng.random() < 0.25 else base
    art = random_art(rng) if other else textures.painted
    return lambda rng, height, width, _: art(rng, height, width, own)


def _bowl(rng: Rng) -> list[Chart]:
    """A bowl or a plate: deep or flat, with a wall of a few per cent of its width."""
    height, wall, bulge = rng.uniform(0.08, 0.7), rng.uniform(0.015, 0.04), rng.uniform(0.3, 1.0)
    foot = rng.uniform(0.3, 0.7) * 0.5
    share = np.linspace(0.0, 1.0, 9)
    outer = [(foot + (0.5 - foot) * s**bulge, height * s) for s in share]
    inner = [(max(r - wall, 0.02), max(z, wall)) for r, z in reversed(outer)]
    return _hollow(outer, inner, wall)


def _hollow(outer: list[tuple[float, float]], inner: list[tuple[float, float]], wall: float) -> list[Chart]:
    """Outside, rim and inside of an object that is open at the top, from profiles (radius, height)."""
    rim = [outer[-1], inner[0]]
    return revolved([[(0.0, 0.0), outer[0]], outer, rim, inner, [inner[-1], (0.0, wall)]], 32)


def _mug(rng: Rng) -> list[Chart]:
    """A hollow cylinder, straight or tapered, with a handle more often than not."""
    height, wall = rng.uniform(0.7, 1.6), 0.04
    low, high = 0.5 * rng.uniform(0.75, 1.0), 0.5
    outer = [(low + (high - low) * s, height * s) for s in np.linspace(0.0, 1.0, 7)]
    inner = [(r - wall, max(z, wall)) for r, z in reversed(outer)]
    charts = _hollow(outer, inner, wall)
    if rng.random() < 0.8:
        reach, thick = rng.uniform(0.2, 0.35), rng.uniform(0.035, 0.06)
        charts.append(
            _arc(np.array([low, 0.0, height / 2]), reach, 0.3 * height, thick, rng.uniform(0.6, 1.4))
        )
    return charts


def _arc(at: Float64, reach: float, half_height: float, thick: float, flatness: float) -> Chart:
    """A round bar bent to half an ellipse in the x-z plane."""
    along, about = np.linspace(-np.pi / 2, np.pi / 2, 13), np.linspace(0.0, 2 * np.pi, 9)
    middle = np.stack([reach * np.cos(along), 0 * along, half_height * np.sin(along)], -1)
    outwards = np.stack([np.cos(along), 0 * along, np.sin(along)], -1)
    sideways = np.array([0.0, 1.0, 0.0])
    points = (
        at
        + middle[:, None]
        + thick * np.cos(about)[None, :, None] * outwards[:, None]
        - thick * flatness * np.sin(about)[None, :, None] * sideways
    )
    flat = np.stack(np.broadcast_arrays(thick * about[None], (reach + half_height) * along[:, None]), -1)
    return flattened(grid_triangles(points), grid_triangles(flat))


def _bar(size: Float64, turn_z: float, at: Float64) -> list[Chart]:
    """The charts of a bar of a size (3,), rotated about z."""
    x, y, z = size / 2
    c, s = np.cos(turn_z), np.sin(turn_z)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    made = blocks([-x, x], [-y, y], [-z, z], np.ones((1, 1, 1), bool), 0.5)
    return [Chart(chart.corners @ R.T + at, chart.flat, chart.size) for chart in made]


def _bars(rng: Rng) -> list[Chart]:
    """A tool of two to four bars that cross or touch: clamps, drills, pliers."""
    charts: list[Chart] = []
    at, turn = np.zeros(3), 0.0
    for _ in range(int(rng.integers(2, 5))):
        size = np.array([rng.uniform(0.4, 1.0), rng.uniform(0.06, 0.3), rng.uniform(0.06, 0.25)])
        charts += _bar(size, turn, at + np.array([0.0, 0.0, rng.uniform(-0.02, 0.02)]))
        end = np.array([np.cos(turn), np.sin(turn), 0.0]) * size[0] * rng.choice([-0.5, 0.0, 0.5])
        at, turn = at + end, turn + rng.uniform(0.3, 2.8)
    return charts


def _flat_tool(rng: Rng) -> list[Chart]:
    """Scissors, a marker, a knife: long and thin."""
    long, thin = 1.0, rng.uniform(0.03, 0.12)
    spread = rng.uniform(0.0, 0.5) * (rng.random() < 0.6)
    charts = _bar(np.array([long, thin * rng.uniform(1.0, 2.0), thin]), spread / 2, np.zeros(3))
    if spread:
        charts += _bar(
            np.array([long, thin * rng.uniform(1.0, 2.0), thin]), -spread / 2, np.array([0, 0, thin * 0.6])
        )
    if rng.random() < 0.6:
        grip = np.array([rng.uniform(0.2, 0.4), thin * rng.uniform(2.0, 4.0), thin * 1.4])
        charts += _bar(grip, spread / 2, np.array([-long * 0.4, 0.0, 0.0]))
    return charts


def _fruit(rng: Rng) -> list[Chart]:
    """A ball, a pear or a banana."""
    knots = rng.uniform(0.35, 0.5, 4) * [0.6, 1.0, rng.uniform(0.6, 1.0), 0.5]
    height = rng.uniform(0.35, 1.3)
    z = np.linspace(-1.0, 1.0, 15)
    radius = np.interp(z, np.linspace(-1, 1, 4), knots) * np.sqrt(np.maximum(1.0 - z**2, 0.0))
    side = [(float(max(r, 0.01)), float(h * height)) for r, h in zip(radius[1:-1], z[1:-1], strict=True)]
    charts = revolved([[(0.0, -height), side[0]], side, [side[-1], (0.0, height)]], 24)
    bend = rng.uniform(0.2, 0.9) * (rng.random() < 0.5)
    out = []
    for chart in charts:
        corners = chart.corners.copy()
        corners[..., 0] += bend * corners[..., 2] ** 2 / max(height, 0.5)
        out.append(Chart(corners, chart.flat, chart.size))
    return out
