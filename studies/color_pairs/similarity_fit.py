"""The open parameters of the similarity, chosen by how well it tells same surface points from different ones.

Rendered views under changed light, with noise and blur, give scene pairs whose true place on the model is
known. A pair and the rows of the reference database at its place (and of its direction) are *same*, rows far
from it are *different*. Of each scene pair, the similarity with the best of the same rows is compared to
those with different ones: the area under the ROC curve is the share of comparisons that come out right.
Colours are brought back by the light read from the pairs alone, as matching does. The parameters are searched
one after the other for the largest area; the overall sharpness, which no order depends on, is set so that the
median similarity of same pairs stays what it was, and thresholds keep their meaning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from huepose.colorpair.extract import extract
from huepose.colorpair.lifting import lift
from huepose.colorpair.light import relit
from huepose.colorpair.similarity import SimilarityConfig, paired_similarity
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float32, Float64, Int64
from huepose.model.pairs import reference_pairs
from huepose.model.types import ReferenceModel
from huepose.paper.extended.light import lights_of
from huepose.support.progress import progress
from studies.color_pairs.changes import blur, exposure, noise, white_balance
from studies.color_pairs.views import StudyView, object_views

SAME, FAR = 0.015, 0.1
"""Diameters: nearer than the first is the same place, farther than the second another."""

STEPS: Mapping[str, tuple[float, ...]] = {
    "lightness": (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0),
    "contrast": (0.0, 0.5, 1.0, 2.0, 4.0, 6.0, 9.0, 14.0, 20.0),
    "contrast_floor": (0.02, 0.04, 0.08, 0.15, 0.3),
    "luminance": (0.1, 0.15, 0.2, 0.3, 0.45, 0.7),
}
"""Values tried for each parameter, beside `direction`, which sets the scale."""


@dataclass(frozen=True, eq=False)
class LabelledPairs:
    """Scene pairs a (N, 2, 3), the rows compared with each, b (N, K, 2, 3), and which of these are at its
    place (N, K); every row has at least one that is and one that is not."""

    a: Float32
    b: Float32
    same: Bool


@dataclass(frozen=True)
class SimilarityQuality:
    """area: under the ROC curve; recall: of same pairs when one different row in a hundred passes; median:
    similarity of same pairs."""

    area: float
    recall: float
    median: float


def labelled_pairs(
    models: Mapping[str, ReferenceModel], views: int, seed: int, near: int = 6, far: int = 60, each: int = 120
) -> LabelledPairs:
    """Comparisons from `views` rendered views of each object; `each` scene pairs a view."""
    rng = np.random.default_rng(seed)
    parts: list[tuple[Float32, Float32, Bool]] = []
    pixels = {n: m.pairs.parameters["coarse_pixels_per_m"] * m.diameter_m for n, m in models.items()}
    for name, model in progress(list(models.items()), "objects"):
        for view in object_views({name: model}, views, pixels[name], int(rng.integers(1 << 30))):
            part = _of_view(model, view, rng, near, far, each)
            if part is not None:
                parts.append(part)
    return LabelledPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def disturbed_color(view: StudyView, rng: np.random.Generator) -> np.ndarray:
    """The view's picture under another light, through a camera with noise and blur."""
    color = exposure(view.frame.color, rng.uniform(-1.2, 0.8))
    color = white_balance(color, float(np.exp(rng.uniform(-0.3, 0.3))))
    return noise(blur(color, rng.uniform(0.0, 1.0)), rng.uniform(0.0, 6.0))


def _of_view(
    model: ReferenceModel, view: StudyView, rng: np.random.Generator, near: int, far: int, each: int
) -> tuple[Float32, Float32, Bool] | None:
    reference = reference_pairs(model.pairs)
    seen = extract(disturbed_color(view, rng), view.mask)
    scene, _ = lift(seen, view.frame.depth, view.mask, view.frame.camera)
    if len(scene) < 20:
        return None
    scene = scene.transformed(se3.inverse(view.T_cam_obj))
    light = lights_of(scene.colors, reference.colors, rng)[0][0]
    colors = relit(scene.colors, 1.0 / light)
    a, rows, same = [], [], []
    for i in rng.permutation(len(scene)):
        distance = np.linalg.norm(reference.points - scene.points[i], axis=1) / model.diameter_m
        alike = np.abs(reference.tangents @ scene.tangents[i]) > 0.85
        here, there = np.flatnonzero((distance < SAME) & alike), np.flatnonzero(distance > FAR)
        if not len(here) or not len(there):
            continue
        here = here[np.argsort(distance[here], kind="stable")][:near]
        rows.append(np.concatenate([np.resize(here, near), rng.choice(there, far)]))
        same.append(np.arange(near + far) < near)
        a.append(colors[i])
        if len(a) == each:
            break
    if not a:
        return None
    chosen: Int64 = np.array(rows)
    return np.array(a), reference.colors[chosen], np.array(same)


def quality_of(data: LabelledPairs, config: SimilarityConfig) -> SimilarityQuality:
    """How well a similarity tells same from different."""
    n, k = data.same.shape
    a = np.repeat(data.a, k, 0)
    table = paired_similarity(a, data.b.reshape(-1, 2, 3), config).reshape(n, k)
    best = np.where(data.same, table, -1.0).max(1)
    others: Float64 = np.sort(table[~data.same].astype(np.float64))
    below = np.searchsorted(others, best, "left") + np.searchsorted(others, best, "right")
    threshold = others[int(0.99 * (len(others) - 1))]
    return SimilarityQuality(
        float(below.mean() / (2 * len(others))), float((best > threshold).mean()), float(np.median(best))
    )


def fitted_similarity(
    data: LabelledPairs, start: SimilarityConfig | None = None, rounds: int = 2
) -> tuple[SimilarityConfig, Sequence[tuple[str, float, float]]]:
    """The parameters with the largest area, and what was tried: (name, value, area)."""
    start = start or SimilarityConfig()
    best, area = start, quality_of(data, start).area
    tried: list[tuple[str, float, float]] = []
    for _ in range(rounds):
        before = best
        for name, values in STEPS.items():
            for value in values:
                trial = replace(best, **{name: value})
                found = quality_of(data, trial).area
                tried.append((name, value, found))
                if found > area + 1e-4:
                    best, area = trial, found
        if best == before:
            break
    return as_sharp(data, best, quality_of(data, start).median), tried


def as_sharp(data: LabelledPairs, config: SimilarityConfig, median: float) -> SimilarityConfig:
    """The same order of similarities, with this median for same pairs: all three costs times one factor."""
    factor = np.log(median) / np.log(quality_of(data, config).median)
    return replace(
        config,
        direction=float(config.direction * factor),
        contrast=float(config.contrast * factor),
        luminance=float(config.luminance / np.sqrt(factor)),
    )
