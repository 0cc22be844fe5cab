"""Of the colour pairs of a view, how many are found again, and known again, when the picture changes?

A pair is found again when the changed picture has one within two pixels of its place (the spacing of pairs
along an edge; pixels of the coarser picture), within one across the edge, and of the same direction. It is
known again when, besides, at most one in ten of all pairs of the changed picture is more similar to it than
the one at its own place. The second figure is also given after the colours were brought back by the light
that `paper.light` reads from the pairs alone, as matching does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from huepose.colorpair.extract import extract
from huepose.colorpair.light import relit
from huepose.colorpair.similarity import similarity
from huepose.colorpair.types import ColorPairs
from huepose.geometry.arrays import Bool, Float32, Int
from huepose.model.types import ReferenceModel
from huepose.paper.extended.light import lights_of
from huepose.support.progress import progress
from studies.color_pairs.changes import SCALE, SERIES, ChangeSeries
from studies.color_pairs.views import StudyView, object_view

PLACE_PX, ACROSS_PX, ANGLE_DEG = 2.0, 1.0, 25.0
RIVALS = 0.1
"""Share of the other pairs that may be more similar than the right one."""


@dataclass(frozen=True)
class Repeated:
    """One amount of one change: shares (0..1) of the unchanged view's pairs, averaged over views."""

    change: str
    amount: float
    found: float
    known: float
    known_in_its_light: float
    pairs: float


def repeatability(
    models: Mapping[str, ReferenceModel],
    views: int = 3,
    seed: int = 0,
    series: Sequence[ChangeSeries] = SERIES,
) -> list[Repeated]:
    """Every change at every amount, over `views` views of each object at the scale of the reference."""
    rng = np.random.default_rng(seed)
    scenes = []
    for model in models.values():
        pixels = model.pairs.parameters["coarse_pixels_per_m"] * model.diameter_m
        for _ in range(views):
            direction = rng.normal(size=3)
            scenes.append((model, direction / np.linalg.norm(direction), rng.uniform(-np.pi, np.pi), pixels))
    rows = []
    for change in progress(series, "changes"):
        per_amount: dict[float, list[tuple[float, ...]]] = {a: [] for a in change.amounts}
        for model, direction, roll, pixels in scenes:
            view = object_view(model, direction, roll, pixels)
            before = extract(view.frame.color, view.mask)
            if not len(before):
                continue
            for amount in change.amounts:
                after = _changed(model, view, direction, roll, pixels, change, amount)
                pixel = max(1.0, 1.0 / amount) if change.name == SCALE else 1.0
                per_amount[amount].append(compare(before, after, pixel))
        for amount, values in per_amount.items():
            rows.append(Repeated(change.name, amount, *(float(v) for v in np.mean(values, axis=0))))
    return rows


def compare(before: ColorPairs, after: ColorPairs, pixel: float = 1.0) -> tuple[float, float, float, float]:
    """Shares of the pairs of one picture that are found, known, known in its light in another, and the
    number of pairs of the first; places are in pixels of the first, a `pixel` is that of the coarser."""
    if not len(after):
        return 0.0, 0.0, 0.0, float(len(before))
    at, found = counterparts(before, after, pixel)
    light = lights_of(after.colors, before.colors, np.random.default_rng(0))[0][0]
    known = _known(before.colors, after.colors, at) & found
    in_its_light = _known(before.colors, relit(after.colors, 1.0 / light), at) & found
    return float(found.mean()), float(known.mean()), float(in_its_light.mean()), float(len(before))


def counterparts(before: ColorPairs, after: ColorPairs, pixel: float = 1.0) -> tuple[Int, Bool]:
    """For each pair the index (N,) of the one at its place in another picture, and whether there is one."""
    way = np.stack([np.cos(before.directions), np.sin(before.directions)], 1)
    offset = after.pixels[None] - before.pixels[:, None]
    across = np.abs((offset * way[:, None]).sum(2))
    distance = np.linalg.norm(offset, axis=2)
    turn = np.abs(np.cos(before.directions[:, None] - after.directions[None]))
    fits = (
        (distance <= PLACE_PX * pixel)
        & (across <= ACROSS_PX * pixel)
        & (turn >= np.cos(np.radians(ANGLE_DEG)))
    )
    at = np.where(fits, distance, np.inf).argmin(1)
    return at, fits.any(1)


def _known(before: Float32, after: Float32, at: Int) -> Bool:
    """Whether few of all pairs (M, 2, 3) are more like each pair (N, 2, 3) than the one `at` its place is."""
    table = similarity(before, after)
    own = table[np.arange(len(before)), at]
    return np.asarray((table > own[:, None]).mean(1) <= RIVALS)


def _changed(
    model: ReferenceModel,
    view: StudyView,
    direction: np.ndarray,
    roll: float,
    pixels: float,
    change: ChangeSeries,
    amount: float,
) -> ColorPairs:
    """Pairs of the changed picture, in pixels of the unchanged one."""
    if change.name != SCALE:
        return extract(change.apply(view.frame.color, amount), view.mask)
    other = object_view(model, direction, roll, pixels * amount)
    # brought to the scale of the reference where the picture is finer than that, as matching does
    pairs = extract(other.frame.color, other.mask, scale=min(1.0, 1.0 / amount))
    size, wide = view.frame.camera.width, other.frame.camera.width
    places = (pairs.pixels - (wide - 1) / 2) / amount + (size - 1) / 2
    return ColorPairs(places.astype(np.float32), pairs.directions, pairs.widths, pairs.colors)
