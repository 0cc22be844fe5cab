"""Textures made by code: labels, pictures, tables, bar codes, warning stickers, wood. All RGB uint8.

Every function makes an image of a given size. No texture is periodic, so it determines the orientation of an
object.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from huepose.geometry.arrays import Float32, Rng, UInt8

Colour = tuple[int, int, int]
Art = Callable[[Rng, int, int, "Palette"], UInt8]

_FONT = cv2.FONT_HERSHEY_DUPLEX
_WORDS = (
    *("net", "weight", "contains", "water", "sugar", "salt", "citric", "acid", "natural", "flavour", "store"),
    *("in", "cool", "dry", "place", "best", "before", "see", "lid", "shake", "well", "serve", "cold", "keep"),
    *(
        "upright",
        "recycle",
        "made",
        "of",
        "wheat",
        "oats",
        "rice",
        "corn",
        "cocoa",
        "berries",
        "energy",
        "fat",
    ),
)


@dataclass(frozen=True)
class Palette:
    """Five colours that go together."""

    base: Colour
    accent: Colour
    dark: Colour
    light: Colour
    spot: Colour


def palette(hue: float, rng: Rng) -> Palette:
    """Colours around `hue` (0..1), its near opposite for accents and a third one for spots."""

    def rgb(h: float, s: float, v: float) -> Colour:
        r, g, b = colorsys.hsv_to_rgb(h % 1.0, s, v)
        return round(255 * r), round(255 * g), round(255 * b)

    opposite = hue + 0.5 + rng.uniform(-0.08, 0.08)
    return Palette(
        rgb(hue, rng.uniform(0.65, 0.8), rng.uniform(0.66, 0.8)),
        rgb(opposite, rng.uniform(0.6, 0.8), rng.uniform(0.75, 0.9)),
        rgb(hue + 0.02, 0.6, rng.uniform(0.16, 0.24)),
        rgb(hue, 0.08, rng.uniform(0.9, 0.96)),
        rgb(hue + rng.uniform(0.2, 0.3), 0.75, 0.85),
    )


def plain(height: int, width: int, colour: Colour) -> UInt8:
    """An image (height, width, 3) of one colour."""
    return np.full((height, width, 3), colour, np.uint8)


def painted(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """Paint, a little uneven."""
    uneven = clouds(rng, height, width, max(height, width) / 3, 3)
    return mixed(p.base, p.accent, 0.12 * uneven)


def clouds(rng: Rng, height: int, width: int, cell: float, octaves: int = 4) -> Float32:
    """Smooth noise (height, width) in 0..1 with patches of about `cell` px and finer ones on them."""
    total: Float32 = np.zeros((height, width), np.float32)
    weight = 1.0
    for _ in range(octaves):
        rows, columns = max(2, round(height / cell) + 1), max(2, round(width / cell) + 1)
        grid = rng.random((rows, columns), dtype=np.float32)
        total += weight * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        weight, cell = weight * 0.55, max(cell * 0.5, 1.0)
    low, high = np.quantile(total, (0.01, 0.99))
    return np.asarray(np.clip((total - low) / max(float(high - low), 1e-6), 0, 1), np.float32)


def mixed(a: Colour, b: Colour, share: Float32) -> UInt8:
    """Colours from `a` (share 0) to `b` (share 1) in 255 steps, share (H, W)."""
    steps = np.linspace(0.0, 1.0, 256)[:, None]
    table = np.rint(np.array(a) + steps * (np.array(b) - np.array(a))).astype(np.uint8)
    return np.asarray(table[(np.clip(share, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)], np.uint8)


def write(
    image: UInt8, text: str, box: tuple[float, float, float, float], colour: Colour, bold: int = 2
) -> None:
    """Text filling the box x, y, w, h (fractions of the image) as large as fits, centred; in place."""
    height, width = image.shape[:2]
    x, y, w, h = box[0] * width, box[1] * height, box[2] * width, box[3] * height
    (tw, th), base = cv2.getTextSize(text, _FONT, 1.0, bold)
    scale = min(w / tw, h / (th + base))
    (tw, th), base = cv2.getTextSize(text, _FONT, scale, max(1, round(bold * scale)))
    origin = (round(x + (w - tw) / 2), round(y + (h + th) / 2))
    cv2.putText(image, text, origin, _FONT, scale, colour, max(1, round(bold * scale)), cv2.LINE_AA)


def paragraph(
    image: UInt8, rng: Rng, box: tuple[float, float, float, float], lines: int, ink: Colour
) -> None:
    """Lines of small text, ragged on the right; in place."""
    for k in range(lines):
        words = " ".join(rng.choice(_WORDS, int(rng.integers(3, 6))))
        row = (box[0], box[1] + box[3] * k / lines, box[2] * rng.uniform(0.7, 1.0), box[3] / lines * 0.9)
        write(image, words, row, ink, 1)


def barcode(image: UInt8, rng: Rng, box: tuple[float, float, float, float]) -> None:
    """A white field with black bars of random widths; in place."""
    height, width = image.shape[:2]
    x0, x1 = round(box[0] * width), round((box[0] + box[2]) * width)
    y0, y1 = round(box[1] * height), round((box[1] + box[3]) * height)
    image[y0:y1, x0:x1] = 245
    unit, x = max(1.0, (x1 - x0) / 60), x0 + (x1 - x0) * 0.08
    while x < x1 - (x1 - x0) * 0.08:
        bar = unit * rng.integers(1, 4)
        image[y0 + round(0.1 * (y1 - y0)) : y1 - round(0.15 * (y1 - y0)), round(x) : round(x + bar)] = 20
        x += bar + unit * rng.integers(1, 4)


def badge(
    image: UInt8, centre: tuple[float, float], radius: float, text: str, fill: Colour, ink: Colour
) -> None:
    """A star-shaped badge with a word, radius in fractions of the shorter side; in place."""
    height, width = image.shape[:2]
    r = radius * min(height, width)
    k = np.arange(32)
    reach = np.where(k % 2 == 0, r, 0.82 * r)
    angle = k * np.pi / 16
    c = np.array([centre[0] * width, centre[1] * height])
    star = c + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    cv2.fillPoly(image, [np.rint(star).astype(np.int32)], fill, cv2.LINE_AA)
    cv2.circle(image, (round(c[0]), round(c[1])), round(0.7 * r), ink, max(1, round(r * 0.04)), cv2.LINE_AA)
    side = 1.2 * r
    write(
        image,
        text,
        ((c[0] - side / 2) / width, (c[1] - side / 4) / height, side / width, side / 2 / height),
        ink,
    )


def picture(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """A still life: sky, hills, and shaded fruit with stalks, under a veil of noise."""
    rows = np.linspace(0, 1, height, dtype=np.float32)[:, None] * np.ones((1, width), np.float32)
    image = mixed(
        p.light, p.accent, np.clip(rows + 0.5 * (clouds(rng, height, width, width / 3) - 0.5), 0, 1)
    )
    for k, colour in enumerate((p.spot, p.base)):
        ridge = (0.5 + 0.16 * k + 0.14 * (clouds(rng, 1, width, width / 3, 3)[0] - 0.5)) * height
        hill = np.arange(height)[:, None] > ridge[None]
        image[hill] = (0.75 * np.array(colour) + 0.25 * image[hill]).astype(np.uint8)
    size = min(height, width)
    for _ in range(6):
        r = size * rng.uniform(0.09, 0.2)
        x, y = rng.uniform(0.1, 0.9) * width, rng.uniform(0.5, 0.92) * height
        skin = np.array((p.accent, p.spot, p.dark, p.light)[int(rng.integers(4))], np.float32)
        for s in np.linspace(0, 1, 8):
            shade = tuple(int(c) for c in np.clip(skin * (0.55 + 0.6 * s), 0, 255))
            at = (round(x - 0.3 * s * r), round(y - 0.3 * s * r))
            cv2.circle(image, at, max(1, round(r * (1 - 0.85 * s))), shade, -1, cv2.LINE_AA)
        tip = (round(x + r * rng.uniform(-0.4, 0.6)), round(y - 1.5 * r))
        cv2.line(image, (round(x), round(y - 0.8 * r)), tip, p.dark, max(1, round(r * 0.12)), cv2.LINE_AA)
    grain = (clouds(rng, height, width, size / 12, 3) - 0.5) * 30
    return np.asarray(np.clip(image + grain[..., None], 0, 255), np.uint8)


def front(title: str, subtitle: str, word: str) -> Art:
    """The face of a package: title on a band, a picture, a badge, a line of small print."""

    def draw(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
        slope = np.linspace(0, 1, height, dtype=np.float32)[:, None] * np.ones((1, width), np.float32)
        image = mixed(p.base, p.dark, 0.6 * slope)
        band = np.array([[0, 0.08], [1, 0.04], [1, 0.3], [0, 0.36]]) * (width, height)
        cv2.fillPoly(image, [np.rint(band).astype(np.int32)], p.light, cv2.LINE_AA)
        write(image, title, (0.06, 0.08, 0.88, 0.2), p.dark, 3)
        top, bottom, left, right = (
            round(0.42 * height),
            round(0.86 * height),
            round(0.07 * width),
            round(0.93 * width),
        )
        image[top:bottom, left:right] = picture(rng, bottom - top, right - left, p)
        cv2.rectangle(image, (left, top), (right, bottom), p.light, max(1, width // 120), cv2.LINE_AA)
        write(image, subtitle, (0.08, 0.335, 0.6, 0.075), p.light, 2)
        badge(image, (0.8, 0.47), 0.17, word, p.spot, p.light)
        write(image, f"NET {int(rng.integers(120, 900))} g", (0.06, 0.88, 0.4, 0.08), p.light, 1)
        return image

    return draw


def facts(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
    """The back of a package: a table, ingredients, a bar code."""
    image = mixed(p.light, p.base, 0.25 * clouds(rng, height, width, width / 2, 2))
    write(image, "FACTS", (0.08, 0.03, 0.45, 0.1), p.dark, 3)
    badge(image, (0.8, 0.1), 0.11, "OK", p.accent, p.light)
    for k, word in enumerate(rng.permutation(_WORDS)[:8]):
        y = round((0.16 + 0.04 * k) * height)
        cv2.line(image, (round(0.07 * width), y), (round(0.93 * width), y), p.dark, 1 + (k == 0) * 3)
        write(image, str(word), (0.08, 0.164 + 0.04 * k, 0.3, 0.033), p.dark, 1)
        write(image, f"{rng.uniform(0, 90):.1f} g", (0.66, 0.164 + 0.04 * k, 0.26, 0.033), p.dark, 1)
    paragraph(image, rng, (0.08, 0.52, 0.84, 0.22), 6, p.dark)
    barcode(image, rng, (0.36, 0.78, 0.56, 0.17))
    cv2.circle(image, (round(0.2 * width), round(0.87 * height)), round(0.1 * width), p.spot, -1, cv2.LINE_AA)
    return image


def blocks(text: str) -> Art:
    """Slanted stripes with blobs, and a word in the middle."""

    def draw(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
        v, u = np.mgrid[:height, :width].astype(np.float32)
        wave = clouds(rng, height, width, max(height, width) / 2, 2)
        phase = (u * rng.uniform(0.5, 1.0) + v) / (0.13 * max(height, width)) + 2.5 * wave
        colours = np.array([p.base, p.spot, p.base, p.accent, p.dark], np.uint8)
        image = np.ascontiguousarray(colours[np.floor(phase).astype(int) % 5])
        for _ in range(5):
            at = (int(rng.integers(width)), int(rng.integers(height)))
            r = max(2, round(rng.uniform(0.04, 0.12) * max(height, width)))
            cv2.circle(image, at, r, (p.light, p.dark, p.accent)[int(rng.integers(3))], -1, cv2.LINE_AA)
        cv2.rectangle(
            image,
            (round(0.08 * width), round(0.36 * height)),
            (round(0.92 * width), round(0.62 * height)),
            p.light,
            -1,
        )
        write(image, text, (0.1, 0.37, 0.8, 0.24), p.dark, 2)
        return image

    return draw


def sticker(text: str, style: int) -> Art:
    """Painted wood with a hazard band, a label and ornaments. The four styles (style mod 4) differ in layout
    and colours, so that opposite sides of an object can be distinguished from afar."""
    style %= 4

    def draw(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
        long = width >= height
        rows, columns = (height, width) if long else (width, height)
        grain = clouds(rng, rows, max(2, columns // 12), rows / 16, 3)
        image = mixed(
            p.spot if style == 3 else p.base,
            p.dark,
            0.55 * cv2.resize(grain, (columns, rows), interpolation=cv2.INTER_LINEAR).astype(np.float32),
        )
        v, u = np.mgrid[:rows, :columns].astype(np.float32)
        band = (u < 0.16 * columns, u > 0.88 * columns, v > 0.8 * rows, np.abs(u - v) < 0.12 * columns)[style]
        stripe = np.floor((u + v * (-1) ** style) / (0.07 * columns)).astype(int) % 2 == 0
        image[band & stripe] = p.dark
        image[band & ~stripe] = p.light if style == 3 else p.spot
        left, top = ((0.22, 0.16), (0.4, 0.1), (0.1, 0.08), (0.3, 0.3))[style]
        x0, x1 = round(left * columns), round((left + rng.uniform(0.38, 0.46)) * columns)
        y0, y1 = round(top * rows), round((top + (0.68, 0.55, 0.6, 0.62)[style]) * rows)
        label = plain(max(y1 - y0, 4), max(x1 - x0, 4), p.accent if style == 1 else p.light)
        write(label, text, (0.05, 0.06, 0.9, 0.5), p.dark, 2)
        paragraph(label, rng, (0.06, 0.58, 0.6, 0.36), 2, p.dark)
        barcode(label, rng, (0.7, 0.6, 0.25, 0.34))
        image[y0 : y0 + label.shape[0], x0 : x0 + label.shape[1]] = label
        if style == 0:
            tail, tip = (
                (round(0.74 * columns), round(0.7 * rows)),
                (round(0.94 * columns), round(0.25 * rows)),
            )
            cv2.arrowedLine(image, tail, tip, p.accent, max(2, rows // 12), cv2.LINE_AA, tipLength=0.4)
        elif style == 1:
            badge(image, (0.2, 0.5), 0.33, "QC", p.spot, p.dark)
        elif style == 2:
            y0, x0 = round(0.1 * rows), round(0.62 * columns)
            image[y0 : round(0.68 * rows), x0 : round(0.94 * columns)] = picture(
                rng, round(0.68 * rows) - y0, round(0.94 * columns) - x0, p
            )
        for _ in range(5):
            at = (round(rng.uniform(0.0, 1.0) * columns), round(rng.choice([0.03, 0.95]) * rows))
            ink = (p.light, p.accent, p.light, p.dark)[style]
            cv2.circle(image, at, max(2, round(rng.uniform(0.04, 0.12) * rows)), ink, -1, cv2.LINE_AA)
        return image if long else np.ascontiguousarray(np.rot90(image))

    return draw


def lid(text: str) -> Art:
    """The end of a can or a cap: rings, a word, a mark on one side."""

    def draw(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
        v, u = np.mgrid[:height, :width].astype(np.float32)
        radius = np.hypot(u - width / 2, v - height / 2) / (0.5 * min(height, width))
        image = mixed(p.light, p.dark, 0.35 + 0.25 * np.sin(radius * 14.0).astype(np.float32))
        image[radius < 0.72] = p.spot
        cv2.ellipse(
            image,
            (width // 2, round(0.26 * height)),
            (round(0.2 * width), round(0.08 * height)),
            0,
            0,
            360,
            p.dark,
            -1,
        )
        write(image, text, (0.2, 0.4, 0.6, 0.22), p.light, 2)
        paragraph(image, rng, (0.27, 0.64, 0.46, 0.14), 2, p.dark)
        return image

    return draw


def wrapper(title: str, subtitle: str, word: str) -> Art:
    """What goes around a can: the front, the facts, and stripes, side by side, with bands above and below."""

    def draw(rng: Rng, height: int, width: int, p: Palette) -> UInt8:
        image = mixed(p.dark, p.base, clouds(rng, height, width, width / 4, 3))
        top, bottom = round(0.04 * height), round(0.96 * height)
        edges = [0, round(0.42 * width), round(0.72 * width), width]
        arts = (front(title, subtitle, word), facts, blocks(title[::-1]))
        for art, left, right in zip(arts, edges[:-1], edges[1:], strict=True):
            image[top:bottom, left:right] = art(rng, bottom - top, right - left, p)
        image[:top], image[bottom:] = p.spot, p.accent
        return image

    return draw
