"""Twenty-four objects: boxes, cans, bottles, bowls, tools with handles, toys; a third have little texture.

Shapes are closed surfaces through rounded cross-sections along a line: soft boxes, handles, hulls, bowls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float, Float64
from huepose.geometry.mesh import Mesh
from huepose.scenes.charts import Chart, flattened, grid_triangles
from huepose.scenes.shapes import printed
from huepose.scenes.textures import Art
from huepose.scenes.unseen.prints import (
    cells,
    coat,
    contours,
    grain,
    halves,
    leaves,
    marbled,
    marked,
    scheme,
    signs,
    splashes,
    tiles,
    trim,
    wires,
)

SEGMENTS = 40
"""Number of corners of a cross-section."""

STEP_M = 0.008
"""Longest step along the line, so that triangles stay small."""


def loft(
    centres: Sequence[Sequence[float]] | Float,
    radii: Sequence[Sequence[float]] | Float,
    power: float = 2.0,
    axis: tuple[float, float, float] | None = (0.0, 0.0, 1.0),
    across: tuple[float, float, float] = (1.0, 0.0, 0.0),
) -> list[Chart]:
    """A closed surface through K cross-sections, as three charts: the first end, the unrolled side, the
    last end.

    centres (K, 3) m; radii (K, 2) m: of each cross-section along `across` and at right angles to it; power:
    2 is an ellipse, 1 a diamond, larger values approach a rectangle; axis: normal of the cross-sections, None
    for the direction of the line itself."""
    middle, radius = _dense(np.asarray(centres, np.float64), np.asarray(radii, np.float64))
    along = np.gradient(middle, axis=0) if axis is None else np.broadcast_to(np.array(axis), middle.shape)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    u = np.array(across) - (along @ np.array(across))[:, None] * along
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(along, u)
    angle = np.linspace(0.0, 2 * np.pi, SEGMENTS + 1)
    turn = np.stack([np.cos(angle), np.sin(angle)], -1)
    turn[-1] = turn[0]
    reach = (np.abs(turn[None] / radius[:, None]) ** power).sum(-1) ** (-1.0 / power)
    flat_rings = reach[..., None] * turn  # (K, SEGMENTS + 1, 2)
    rings = middle[:, None] + flat_rings[..., :1] * u[:, None] + flat_rings[..., 1:] * v[:, None]
    steps = np.linalg.norm(np.diff(rings, axis=1), axis=2)
    around = np.concatenate([[0.0], np.cumsum(steps.max(0))])
    rise = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rings, axis=0), axis=2).max(1))])
    side = np.stack(np.broadcast_arrays(around[None], -rise[:, None]), -1)
    return [
        _end(rings[0], middle[0], flat_rings[0], first=True),
        flattened(grid_triangles(rings), grid_triangles(side)),
        _end(rings[-1], middle[-1], flat_rings[-1], first=False),
    ]


def _end(ring: Float64, middle: Float64, flat_ring: Float64, first: bool) -> Chart:
    """The chart that closes an end: concentric rings that shrink to its centre."""
    count = max(2, int(np.ceil(np.linalg.norm(ring - middle, axis=1).max() / STEP_M)))
    shares = np.linspace(0.0, 1.0, count + 1)[:: 1 if first else -1, None, None]
    points, flat = middle + shares * (ring - middle), shares * flat_ring * (-1.0 if first else 1.0, -1.0)
    return flattened(grid_triangles(points), grid_triangles(flat))


def _dense(centres: Float64, radii: Float64) -> tuple[Float64, Float64]:
    """The same line with more cross-sections, at most STEP_M apart."""
    reach = np.abs(np.diff(radii, axis=0)).max(1)
    steps = np.maximum(np.linalg.norm(np.diff(centres, axis=0), axis=1), reach)
    counts = np.maximum(1, np.ceil(steps / STEP_M).astype(int))
    at = np.concatenate([*(k + np.arange(n) / n for k, n in enumerate(counts)), [len(centres) - 1.0]])
    known = np.arange(len(centres))
    return (
        np.stack([np.interp(at, known, column) for column in centres.T], -1),
        np.stack([np.interp(at, known, column) for column in radii.T], -1),
    )


def arc(
    middle: tuple[float, float, float], radii: tuple[float, float], degrees: tuple[float, float]
) -> Float64:
    """Points (K, 3) of an arc of an ellipse in the x-z plane, 0 degrees at +x, 90 at +z."""
    angle = np.radians(np.linspace(*degrees, 17))
    zero = np.zeros_like(angle)
    around = np.stack([radii[0] * np.cos(angle), zero, radii[1] * np.sin(angle)], -1)
    return np.asarray(np.array(middle) + around)


Part = tuple[Sequence[Chart], Sequence[Art]]


def upright(
    profile: Sequence[tuple[float, float, float]], power: float = 2.0, at: tuple[float, float] = (0.0, 0.0)
) -> list[Chart]:
    """A loft along z: profile of (radius along x, radius along y, height), metres."""
    return loft([(*at, z) for _, _, z in profile], [(a, b) for a, b, _ in profile], power)


def rod(a: Sequence[float], b: Sequence[float], radius: float, power: float = 2.0) -> list[Chart]:
    """A straight bar with slightly rounded ends."""
    start, end = np.asarray(a, np.float64), np.asarray(b, np.float64)
    along = (end - start) / np.linalg.norm(end - start)
    across = (0.0, 1.0, 0.0) if abs(along[1]) < 0.9 else (1.0, 0.0, 0.0)
    soft = 0.3 * radius
    line = [start, start + soft * along, end - soft * along, end]
    r = [0.8 * radius, radius, radius, 0.8 * radius]
    axis = (float(along[0]), float(along[1]), float(along[2]))
    return loft(np.array(line), [(x, x) for x in r], power, axis, across)


def bent(line: np.ndarray, radius: float) -> list[Chart]:
    """A bar along a line in the x-z plane."""
    return loft(line, np.full((len(line), 2), radius), axis=None, across=(0.0, 1.0, 0.0))


def _soft(a: float, b: float, h: float, r: float) -> list[tuple[float, float, float]]:
    """A prism with rounded edges: half sides a, b, half height h, radius r."""
    return [(a - r, b - r, -h), (a - 0.3 * r, b - 0.3 * r, -h + 0.3 * r), (a, b, -h + r), (a, b, h - r),
            (a - 0.3 * r, b - 0.3 * r, h - 0.3 * r), (a - r, b - r, h)]  # fmt: skip


def _bowl(a: float, b: float, h: float, wall: float, foot: float) -> list[tuple[float, float, float]]:
    """Outside from the foot to the rim, inside back to the floor; foot: share of the radii."""
    s = np.linspace(0.0, 1.0, 7)
    grow = foot + (1 - foot) * np.sin(0.5 * np.pi * s)
    outer = [(a * g, b * g, h * x) for g, x in zip(grow, s, strict=True)]
    inner = [(a * g - wall, b * g - wall, max(h * x, wall)) for g, x in zip(grow[::-1], s[::-1], strict=True)]
    return [*outer, *inner]


def _all(art: Art) -> tuple[Art, Art, Art]:
    return art, art, art


def _boxes_and_cans() -> dict[str, list[Part]]:
    bucket = [(0.04, 0.04, -0.05), (0.05, 0.05, 0.045), (0.052, 0.052, 0.05)]
    wedge = [(0.07, 0.05, -0.035), (0.045, 0.048, 0.0), (0.015, 0.045, 0.035)]
    return {
        "soft_box": [(upright(_soft(0.06, 0.035, 0.05, 0.01), 8), (marbled, cells, splashes))],
        "thin_book": [(upright(_soft(0.055, 0.08, 0.014, 0.003), 12), (contours, signs, leaves))],
        "lozenge_tin": [(upright(_soft(0.045, 0.045, 0.055, 0.005), 1.35), (tiles, marbled, wires))],
        "wedge": [(upright(wedge, 5), (wires, splashes, splashes))],
        "tall_can": [(upright(_soft(0.033, 0.033, 0.06, 0.004)), (marbled, signs, cells))],
        "oval_tin": [(upright(_soft(0.06, 0.04, 0.018, 0.006), 2.6), (leaves, cells, leaves))],
        "bucket": [
            (upright(bucket), (trim, wires, contours)),
            (bent(arc((0.0, 0.0, 0.045), (0.055, 0.045), (0, 180)), 0.003), _all(trim)),
        ],
    }


def _vessels() -> dict[str, list[Part]]:
    bottle = [
        *((0.036, 0.026, -0.085), (0.038, 0.028, -0.08), (0.038, 0.028, 0.03), (0.03, 0.022, 0.045)),
        *((0.014, 0.014, 0.058), (0.013, 0.013, 0.08)),
    ]
    waves = np.linspace(0.0, 1.0, 9)
    belly = np.sin(np.pi * waves) ** 2
    vase = [(0.028 + 0.02 * b, 0.028 + 0.014 * b, 0.16 * s - 0.08) for s, b in zip(waves, belly, strict=True)]
    spray = [(0.04, 0.028, -0.09), (0.041, 0.029, 0.01), (0.02, 0.018, 0.04), (0.014, 0.014, 0.055)]
    jug = [(0.03, 0.03, -0.07), (0.052, 0.045, -0.02), (0.045, 0.04, 0.03), (0.05, 0.036, 0.07)]
    return {
        "square_bottle": [(upright(bottle, 6), (trim, tiles, trim))],
        "vase": [(upright(vase), (trim, cells, signs))],
        "spray_bottle": [
            (upright(spray, 3), (trim, contours, trim)),
            (rod((-0.025, 0.0, 0.068), (0.05, 0.0, 0.072), 0.016, 4), _all(leaves)),
            (bent(arc((0.06, 0.0, 0.045), (0.03, 0.03), (110, 190)), 0.005), _all(trim)),
        ],
        "jug": [
            (upright(jug), (trim, marbled, wires)),
            (bent(arc((0.045, 0.0, 0.005), (0.035, 0.045), (-75, 75)), 0.007), _all(trim)),
        ],
        "oval_bowl": [(upright(_bowl(0.085, 0.06, 0.05, 0.006, 0.45)), (trim, splashes, tiles))],
        "square_dish": [(upright(_bowl(0.07, 0.07, 0.035, 0.006, 0.7), 5), (trim, tiles, signs))],
        "cup": [
            (upright(_bowl(0.042, 0.042, 0.09, 0.004, 0.85)), (cells, leaves, trim)),
            (bent(arc((0.038, 0.0, 0.045), (0.032, 0.028), (-80, 80)), 0.006), _all(trim)),
        ],
    }


def _toys() -> dict[str, list[Part]]:
    rocket = [(0.02, 0.02, -0.08), (0.03, 0.03, -0.03), (0.026, 0.026, 0.04), (0.004, 0.004, 0.1)]
    boat = [(0.075, 0.022, -0.02), (0.088, 0.03, -0.005), (0.098, 0.036, 0.015), (0.09, 0.03, 0.016)]
    return {
        "rocket": [
            (upright(rocket), (trim, wires, trim)),
            (upright([(0.055, 0.004, -0.085), (0.02, 0.004, -0.02)], 4), _all(contours)),
            (upright([(0.004, 0.045, -0.085), (0.004, 0.02, -0.03)], 4), _all(trim)),
        ],
        "boat": [
            (upright(boat, 1.7), (trim, tiles, splashes)),
            (upright(_soft(0.03, 0.02, 0.02, 0.004), 6, (-0.025, 0.0)), (trim, splashes, tiles)),
            (rod((0.03, 0.0, 0.01), (0.03, 0.0, 0.085), 0.004), _all(trim)),
        ],
    }


def _with_little_texture() -> dict[str, list[Part]]:
    blade = [(0.002, 0.004), (0.036, 0.005), (0.042, 0.006)]
    neck = np.array([(-0.02, 0.0, 0.0), (0.0, 0.0, 0.02), (0.02, 0.0, 0.03)])
    torch = [(0.017, 0.017, -0.09), (0.017, 0.017, 0.03), (0.03, 0.03, 0.055), (0.03, 0.03, 0.075)]
    duck = [(0.035, 0.025, -0.03), (0.052, 0.036, -0.012), (0.05, 0.034, 0.008), (0.025, 0.018, 0.024)]
    head = [(0.016, 0.016, 0.01), (0.026, 0.024, 0.035), (0.012, 0.012, 0.06)]
    half_spool = [(0.05, 0.05, -0.04), (0.05, 0.05, -0.03), (0.022, 0.022, -0.029)]
    spool = [*half_spool, *((a, b, -z) for a, b, z in half_spool[::-1])]
    wheels = [rod((x, -0.038, -0.014), (x, 0.038, -0.014), 0.017) for x in (-0.042, 0.042)]
    return {
        "hammer": [
            (rod((0.0, 0.0, -0.12), (0.0, 0.0, 0.07), 0.012), _all(grain)),
            (rod((-0.045, 0.0, 0.07), (0.04, 0.0, 0.07), 0.018, 5), _all(halves)),
        ],
        "screwdriver": [
            (rod((0.0, 0.0, -0.1), (0.0, 0.0, 0.0), 0.017, 3), _all(marked)),
            (rod((0.0, 0.0, 0.0), (0.0, 0.0, 0.09), 0.004), _all(grain)),
        ],
        "trowel": [
            (
                loft(
                    [(-0.1, 0, 0), (-0.05, 0, 0), (-0.02, 0, 0)], blade, 3, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
                ),
                _all(halves),
            ),
            (bent(neck, 0.005), _all(trim)),
            (rod((0.02, 0.0, 0.03), (0.11, 0.0, 0.03), 0.015, 3), _all(marked)),
        ],
        "saucepan": [
            (upright(_bowl(0.065, 0.065, 0.06, 0.004, 0.9)), (coat, halves, trim)),
            (rod((0.06, 0.0, 0.05), (0.17, 0.0, 0.06), 0.009, 4), _all(trim)),
        ],
        "torch": [
            (upright(torch), (trim, marked, halves)),
            (rod((0.012, 0.0, 0.0), (0.022, 0.0, 0.0), 0.008), _all(trim)),
        ],
        "car": [
            (upright(_soft(0.07, 0.032, 0.017, 0.008), 5), (trim, halves, coat)),
            (upright([(0.042, 0.028, 0.015), (0.03, 0.025, 0.042)], 5, (-0.01, 0.0)), (coat, trim, marked)),
            *((wheel, _all(trim)) for wheel in wheels),
        ],
        "duck": [
            (upright(duck), _all(coat)),
            (upright(head, 2, (0.03, 0.0)), _all(coat)),
            (rod((0.05, 0.0, 0.034), (0.072, 0.0, 0.032), 0.008), _all(trim)),
        ],
        "spool": [(upright(spool), (marked, grain, halves))],
    }


@dataclass(frozen=True, eq=False)
class UnseenObject:
    """mesh: in metres, the origin at the centre of the bounding box; plain: with little texture."""

    name: str
    mesh: Mesh
    plain: bool


def unseen_objects(seed: int = 0) -> list[UnseenObject]:
    """All 24 objects. The same seed gives the same pixels; another seed gives other colours and prints."""
    textured = {**_boxes_and_cans(), **_vessels(), **_toys()}
    little = _with_little_texture()
    out = []
    for number, (name, parts) in enumerate({**textured, **little}.items()):
        rng = np.random.default_rng([seed, number, 71])
        charts = [chart for own, _ in parts for chart in own]
        arts = [art for _, own in parts for art in own]
        mesh = printed(charts, arts, scheme(rng), rng)
        middle = (mesh.vertices.min(0) + mesh.vertices.max(0)) / 2
        moved = Mesh(mesh.vertices - middle, mesh.faces, mesh.uv, mesh.texture)
        out.append(UnseenObject(name, moved, name in little))
    return out
