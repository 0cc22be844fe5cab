"""Makes docs/images/rooms.png: which package of the vision library imports which, read from the code.

    .venv/bin/python docs/make_graph.py

Packages are on the lines of the layers in pyproject.toml. An arrow goes from a package to one that it
imports. Not drawn: imports that follow from other arrows, and those of `support`, `geometry` and `model`,
which nearly all packages import. Ends with an error if the imports have a cycle."""

from __future__ import annotations

from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

import grimp
import numpy as np
import tomllib
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).parents[1]
VERBS = ("propose", "refine", "judge", "select", "believe")
GROUND = ("support", "geometry", "model")
WIDTH, STEP, MARGIN, BOX = 1500, 92, 40, (190, 44)
INK, LINE, VERB, ROOM = (30, 35, 45), (140, 150, 165), (255, 214, 140), (226, 232, 240)
COLUMNS = {
    "evaluation": 0.22, "training": 0.85, "profiles": 0.68, "reinit": 0.36, "estimation": 0.36,
    "tracking": 0.68, "onboarding": 0.10, "perception": 0.60, "paper": 0.83, "scenes": 0.12,
    "datasets": 0.30, "model": 0.62, "colorpair": 0.76, "rendering": 0.40, "drawing": 0.10,
}  # fmt: skip
"""Horizontal position of each package, 0 to 1; the five stages are in the middle."""

SCALE = 2
"""The plot is drawn larger by this factor and then reduced, for smooth lines."""

Rooms = dict[str, set[str]]


def main() -> None:
    """Read the imports, check, draw."""
    layers = layers_of(ROOT / "pyproject.toml")
    rooms = rooms_of(layers)
    tuple(TopologicalSorter(rooms).static_order())  # raises CycleError
    picture = drawn(layers, without_implied({a: b - set(GROUND) for a, b in rooms.items()}))
    picture.save(ROOT / "docs" / "images" / "rooms.png", optimize=True)


def layers_of(path: Path) -> list[list[str]]:
    """The packages, line by line, highest first."""
    contracts = tomllib.loads(path.read_text())["tool"]["importlinter"]["contracts"]
    lines = next(c["layers"] for c in contracts if c.get("containers") == ["huepose"])
    return [line.split(" | ") for line in lines]


def rooms_of(layers: list[list[str]]) -> Rooms:
    """The packages that each package imports."""
    graph = grimp.build_graph("huepose", exclude_type_checking_imports=True)
    names = [name for line in layers for name in line]
    for name in names:
        graph.squash_module(f"huepose.{name}")
    known = set(names)
    return {
        name: {m.split(".")[1] for m in graph.find_modules_directly_imported_by(f"huepose.{name}")}
        & known - {name}
        for name in names
    }


def without_implied(rooms: Rooms) -> Rooms:
    """The same without imports that are also reached through another package."""
    reached: Rooms = {}
    for name in TopologicalSorter(rooms).static_order():
        reached[name] = rooms[name].union(*(reached[other] for other in rooms[name]))
    return {
        name: {b for b in others if not any(b in reached[c] for c in others if c != b)}
        for name, others in rooms.items()
    }


def drawn(layers: list[list[str]], rooms: Rooms) -> Image.Image:
    """The plot of the packages on their lines."""
    height = STEP * len(layers) + 2 * MARGIN
    image = Image.new("RGB", (WIDTH * SCALE, height * SCALE), "white")
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(19 * SCALE)
    places = places_of(layers)
    for name, others in rooms.items():
        for other in others:
            arrow(pen, name, other, places)
    for name, (x, y) in places.items():
        w, h = BOX[0] / 2, BOX[1] / 2
        frame = [SCALE * v for v in (x - w, y - h, x + w, y + h)]
        pen.rounded_rectangle(frame, 9 * SCALE, VERB if name in VERBS else ROOM, LINE, SCALE)
        pen.text((x * SCALE, y * SCALE), name, INK, font, "mm")
    return image.resize((WIDTH, height), Image.Resampling.LANCZOS)


def places_of(layers: list[list[str]]) -> dict[str, tuple[float, float]]:
    """The middle of each package's box, in pixels."""
    return {
        name: (WIDTH * COLUMNS.get(name, 0.5), MARGIN + STEP * (k + 0.5))
        for k, line in enumerate(layers)
        for name in line
    }


def arrow(pen: ImageDraw.ImageDraw, start: str, end: str, places: dict[str, tuple[float, float]]) -> None:
    """Draw an arrow from below one box to above another, with the smallest bend that avoids all others."""
    (x0, y0), (x1, y1) = places[start], places[end]
    y0, y1 = y0 + BOX[1] / 2, y1 - BOX[1] / 2
    others = np.array([place for name, place in places.items() if name not in (start, end)])
    t = np.linspace(0.0, 1.0, 60)[:, None]
    weights = np.hstack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3])
    bends = sorted(np.arange(-900.0, 901.0, 30.0), key=abs)
    curves = []
    for bend in bends:
        low, high = y0 + 0.25 * (y1 - y0), y0 + 0.75 * (y1 - y0)
        curve = weights @ np.array([[x0, y0], [x0 + bend, low], [x1 + bend, high], [x1, y1]])
        apart = np.abs(curve[:, None] - others[None])
        hit = (apart < np.array([BOX[0] / 2 + 8, BOX[1] / 2 + 4])).all(-1).any() or (curve[:, 0] < 5).any()
        curves.append((hit or (curve[:, 0] > WIDTH - 5).any(), curve))
    curve = next((c for hit, c in curves if not hit), curves[0][1])
    for p, q in pairwise((SCALE * curve).tolist()):
        pen.line([tuple(p), tuple(q)], LINE, 2 * SCALE)
    tip = SCALE * np.array([[x1, y1], [x1 - 6, y1 - 11], [x1 + 6, y1 - 11]])
    pen.polygon([tuple(p) for p in tip.tolist()], LINE)


if __name__ == "__main__":
    main()
