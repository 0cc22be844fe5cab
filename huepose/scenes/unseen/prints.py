"""Prints without words or pictures: cells, maps, marbling, splashes, signs, leaves, wires, tiles; and
surfaces with little texture. All RGB uint8; see `huepose.scenes.textures` for the arguments."""

from __future__ import annotations

import colorsys

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Float64, Rng, UInt8
from huepose.scenes.textures import Colour, Palette, clouds, mixed, plain


def scheme(rng: Rng) -> Palette:
    """Five independent random colours."""

    def any_colour(low: float, high: float) -> Colour:
        rgb = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.15, 0.95), rng.uniform(low, high))
        red, green, blue = (round(255 * c) for c in rgb)
        return red, green, blue

    return Palette(
        any_colour(0.45, 0.85),
        any_colour(0.5, 0.95),
        any_colour(0.1, 0.3),
        any_colour(0.85, 1.0),
        any_colour(0.4, 0.9),
    )


def _inks(p: Palette) -> tuple[Colour, ...]:
    return p.base, p.accent, p.dark, p.light, p.spot


def _any(rng: Rng, p: Palette) -> Colour:
    return _inks(p)[int(rng.integers(5))]


def _points(rng: Rng, count: int, height: int, width: int) -> Float64:
    return rng.uniform((0, 0), (width, height), (count, 2))


def cells(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Voronoi cells of unevenly spread points, with dark borders."""
    sites = _points(rng, 40, height, width)
    sites = np.concatenate([sites, sites[:20] + rng.normal(0, 0.06 * max(height, width), (20, 2))])
    v, u = np.mgrid[:height, :width].astype(np.float32)
    distances = np.stack([np.hypot(u - x, v - y) for x, y in sites])
    nearest, away = distances.argmin(0), np.partition(distances, 1, axis=0)[:2]
    tones = np.array([np.array(_any(rng, p)) * rng.uniform(0.6, 1.0) for _ in sites], np.uint8)
    image = tones[nearest]
    image[away[1] - away[0] < 0.012 * max(height, width)] = p.dark
    return np.asarray(image, np.uint8)


def contours(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """A map: heights in steps of colour with lines between them."""
    high = clouds(rng, height, width, max(height, width) / 3, 4)
    image = mixed(p.base, p.light, np.asarray(np.floor(high * 7) / 7, np.float32))
    image[high < 0.25] = p.spot
    edge = np.abs((high * 14) % 1.0 - 0.5) < 0.07
    image[edge] = p.dark
    return image


def marbled(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Distorted bands of colour."""
    size = max(height, width)
    folds = clouds(rng, height, width, size / 2, 5)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    phase = u / size * rng.uniform(2, 4) + v / size * rng.uniform(1, 3) + 5.0 * folds
    colours = np.array([p.base, p.light, p.accent, p.dark, p.spot], np.float32)
    share: Float32 = (phase % 1.0)[..., None]
    k = np.floor(phase).astype(int)
    sharp = np.clip((share - 0.75) * 4, 0, 1)
    return np.asarray(colours[k % 5] * (1 - sharp) + colours[(k + 1) % 5] * sharp, np.uint8)


def splashes(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Splashes of paint: blots, drops around them, lines."""
    image, size = plain(height, width, p.light), max(height, width)
    for at in _points(rng, 26, height, width):
        (x, y), ink, r = at, _any(rng, p), size * rng.uniform(0.01, 0.07)
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        blot = np.stack([np.cos(angle), np.sin(angle)], -1) * (r * rng.uniform(0.6, 1.3, 24))[:, None]
        cv2.fillPoly(image, [np.rint(blot + at).astype(np.int32)], ink, cv2.LINE_AA)
        for dx, dy in rng.normal(0, 2.2 * r, (7, 2)):
            cv2.circle(image, (round(x + dx), round(y + dy)), max(1, round(0.15 * r)), ink, -1, cv2.LINE_AA)
        string = np.cumsum(rng.normal(0, 1.4 * r, (12, 2)), axis=0) + at
        wide = max(1, round(size / 250))
        cv2.polylines(image, [np.rint(string).astype(np.int32)], False, ink, wide, cv2.LINE_AA)
    return image


def signs(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Rows of meaningless signs of several sizes and colours."""
    image, y = mixed(p.light, p.base, 0.3 * clouds(rng, height, width, width / 2, 2)), 0.02 * height
    while y < height:
        tall = height * rng.choice([0.05, 0.07, 0.12, 0.18])
        ink, x = (p.dark, p.dark, p.accent, p.spot)[int(rng.integers(4))], 0.03 * width
        while x < 0.95 * width:
            wide = tall * rng.uniform(0.5, 1.0)
            for _ in range(int(rng.integers(2, 5))):
                stroke = rng.uniform((0, 0), (wide, tall), (3, 2)) + np.array([x, y])
                thick = max(1, round(0.1 * tall))
                cv2.polylines(image, [np.rint(stroke).astype(np.int32)], False, ink, thick, cv2.LINE_AA)
            x += wide + tall * rng.choice([0.25, 0.25, 1.2])
        y += 1.35 * tall
    return image


def leaves(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Overlapping leaves and flowers."""
    image, size = plain(height, width, p.dark), max(height, width)
    for n, (x, y) in enumerate(_points(rng, 70, height, width)):
        ink, r = _any(rng, p), size * rng.uniform(0.03, 0.08)
        turn, petals = rng.uniform(0, 360), (1, 1, 1, 5)[n % 4]
        for k in range(petals):
            angle = turn + 360 * k / petals
            out = (0.8 * r if petals > 1 else 0.0) * np.array(
                [np.cos(np.radians(angle)), np.sin(np.radians(angle))]
            )
            at, axes = (round(x + out[0]), round(y + out[1])), (max(1, round(r)), max(1, round(0.4 * r)))
            cv2.ellipse(image, at, axes, angle, 0, 360, ink, -1, cv2.LINE_AA)
        tip = r * np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
        ends = (round(x - tip[0]), round(y - tip[1])), (round(x + tip[0]), round(y + tip[1]))
        cv2.line(image, *ends, p.light, max(1, round(size / 300)), cv2.LINE_AA)
    return image


def wires(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """A circuit board: paths in steps of 45 degrees with pads, and some chips."""
    image, size = (
        mixed(p.base, p.dark, 0.4 + 0.2 * clouds(rng, height, width, width / 3, 2)),
        max(height, width),
    )
    steps = np.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]])
    for x, y in _points(rng, 34, height, width):
        way = np.concatenate(
            [[[x, y]], steps[rng.integers(8, size=4)] * rng.uniform(0.03, 0.14, (4, 1)) * size]
        )
        path, ink = (
            np.rint(np.cumsum(way, axis=0)).astype(np.int32),
            (p.light, p.accent)[int(rng.integers(2))],
        )
        cv2.polylines(image, [path], False, ink, max(1, round(size / 150)), cv2.LINE_AA)
        for end in (path[0], path[-1]):
            cv2.circle(image, (int(end[0]), int(end[1])), max(2, round(size / 70)), p.spot, -1, cv2.LINE_AA)
    for x, y in _points(rng, 6, height, width):
        w, h = rng.uniform(0.05, 0.16, 2) * size
        cv2.rectangle(image, (round(x), round(y)), (round(x + w), round(y + h)), p.dark, -1)
        cv2.circle(image, (round(x + 0.2 * w), round(y + 0.2 * h)), max(1, round(size / 120)), p.light, -1)
    return image


def tiles(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """A rectangle that is divided repeatedly, each part in a random colour."""
    image = plain(height, width, p.dark)
    fields = [(0, 0, width, height)]
    for _ in range(30):
        k = int(np.argmax([w * h * rng.uniform(0.4, 1.0) for _, _, w, h in fields]))
        x, y, w, h = fields.pop(k)
        cut = rng.uniform(0.3, 0.7)
        if w > h:
            fields += [(x, y, round(cut * w), h), (x + round(cut * w), y, w - round(cut * w), h)]
        else:
            fields += [(x, y, w, round(cut * h)), (x, y + round(cut * h), w, h - round(cut * h))]
    gap = max(1, round(max(height, width) / 150))
    for x, y, w, h in fields:
        image[y + gap : y + h - gap, x + gap : x + w - gap] = np.array(_any(rng, p)) * rng.uniform(0.7, 1.0)
    return image


def coat(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Nearly uniform paint in the base colour."""
    return mixed(p.base, p.dark, 0.06 * clouds(rng, height, width, max(height, width) / 2, 2))


def trim(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Nearly uniform paint in the accent colour: for handles, lids, wheels."""
    return mixed(p.accent, p.dark, 0.06 * clouds(rng, height, width, max(height, width) / 2, 2))


def grain(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Fine streaks, as of wood or brushed metal."""
    streaks = cv2.resize(clouds(rng, max(2, height // 24), width, 4, 3), (width, height)).astype(np.float32)
    return mixed(p.accent, p.light, 0.25 * np.clip(streaks, 0, 1))


def marked(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Paint with a single mark and a stripe."""
    image, size = coat(rng, height, width, p), min(height, width)
    x, y = rng.uniform(0.25, 0.4) * width, rng.uniform(0.4, 0.65) * height
    cv2.circle(image, (round(x), round(y)), max(2, round(0.2 * size)), p.light, -1, cv2.LINE_AA)
    inner = np.array([[0, -0.13], [0.11, 0.09], [-0.11, 0.09]]) * size + (x, y)
    cv2.fillPoly(image, [np.rint(inner).astype(np.int32)], p.dark, cv2.LINE_AA)
    top = round(0.08 * height)
    image[top : top + max(2, round(0.06 * height))] = p.spot
    return image


def halves(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Two colours that meet at a slanted line."""
    image = coat(rng, height, width, p)
    line = np.array([[0, 0.3], [1, 0.75], [1, 1], [0, 1]]) * (width, height)
    cv2.fillPoly(image, [np.rint(line).astype(np.int32)], p.accent, cv2.LINE_AA)
    return image
