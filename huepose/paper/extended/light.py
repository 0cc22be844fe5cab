"""Under which light do the scene's colour pairs look like pairs of the model?

Without a pose it is unknown which scene pair is which model pair, but the whole set of scene pairs must look
like some of the model's. So the gains of the light are searched on a coarse grid and refined by iterated
matching: they maximise the share of scene pairs that have a similar model pair. More than one light can
explain a set: the best few different ones are returned, and the poses found under them are judged later.

Light is three gains. Exposure and the colour of the light multiply XYZ, each channel by its own factor, in
good approximation. CIELAB is linear in the cube roots of XYZ (except for the darkest colours), so light
multiplies the cube roots, too, by the cube roots of the factors. These are the `gain` here.
"""

from __future__ import annotations

import numpy as np

from huepose.geometry.arrays import Float, Float32, Float64
from huepose.support.jit import jit


def cube_roots(lab: Float) -> Float64:
    """Cube roots of relative X, Y, Z (..., 3), white = 1, of CIELAB colours (..., 3)."""
    c = np.asarray(lab, np.float64)
    y = (c[..., 0] + 16.0) / 116.0
    return np.stack([y + c[..., 1] / 500.0, y, y - c[..., 2] / 200.0], -1)


def lab_of(roots: Float) -> Float32:
    """CIELAB (..., 3) float32 of cube roots of X, Y, Z (..., 3); inverse of `cube_roots`."""
    r = np.asarray(roots, np.float64)
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], -1).astype(np.float32)


def relit(lab: Float, gain: Float) -> Float32:
    """Colours (..., 3) CIELAB under a light that is `gain` (3,) times as strong (in cube roots of X, Y, Z).

    `relit(relit(c, g), 1 / g)` is `c`.
    """
    return lab_of(cube_roots(lab) * np.asarray(gain, np.float64))


EXPOSURES = (0.6, 0.7, 0.82, 0.95, 1.1, 1.28, 1.5)
REDS, BLUES = (0.97, 1.03), (0.88, 1.0, 1.12)
"""The grid: gains of X, Y and Z together, and factors of X and of Z."""

SCENE_PAIRS, MODEL_PAIRS = 120, 200
"""Largest numbers of pairs that are compared."""

SIGMA, LIGHTNESS = 8.0, 0.6
"""Standard deviation of the distance of matching pairs, CIELAB units, and the weight of L in it."""

STARTS, ROUNDS = 6, 6
"""Points of the grid that are refined, and iterations of each."""

PRIOR = 0.02
"""Weight of the start, per scene pair."""

DISTINCT = 0.12
"""Two lights are different if they differ by more than this in any log gain."""

LIGHTS = 2
"""Largest number of lights that are returned."""


def lights_of(scene: Float32, model: Float32, rng: np.random.Generator) -> list[tuple[Float64, float]]:
    """Lights as gains (3,) on the cube roots of XYZ, from model to scene, and the share of pairs explained
    (0..1).

    scene (N, 2, 3), model (M, 2, 3) CIELAB. Best first; no light change when either is empty.
    """
    if not len(scene) or not len(model):
        return [(np.ones(3), 0.0)]
    s = cube_roots(scene[_some(len(scene), SCENE_PAIRS, rng)])
    m = _coordinates(cube_roots(model[_some(len(model), MODEL_PAIRS, rng)]), LIGHTNESS)
    grid = [np.array([e * r, e, e * b]) for e in EXPOSURES for r in REDS for b in BLUES]
    coarse = [_fit(s, m, g, SIGMA, LIGHTNESS, 0, 0.0)[0] for g in grid]
    fine = []
    for k in np.argsort(coarse)[::-1][:STARTS]:
        share, gain = _fit(s, m, grid[k], SIGMA, LIGHTNESS, ROUNDS, PRIOR)
        fine.append((gain, float(share)))
    fine.sort(key=lambda light: -light[1])
    kept: list[tuple[Float64, float]] = []
    for gain, share in fine:
        if all(np.abs(np.log(gain / other)).max() > DISTINCT for other, _ in kept):
            kept.append((gain, share))
    return kept[:LIGHTS]


def _some(count: int, limit: int, rng: np.random.Generator) -> np.ndarray:
    return rng.permutation(count)[:limit]


def _coordinates(roots: Float64, lightness: float) -> Float64:
    """Pairs (M, 6) in weighted CIELAB axes without the offset of L: what `_fit` compares."""
    x, y, z = roots[..., 0], roots[..., 1], roots[..., 2]
    out = np.stack([116.0 * lightness * y, 500.0 * (x - y), 200.0 * (y - z)], -1)
    return np.ascontiguousarray(out.reshape(-1, 6))


@jit
def _fit(
    scene: Float64,
    model: Float64,
    start: Float64,
    sigma: float,
    lightness: float,
    rounds: int,
    prior: float,
) -> tuple[float, Float64]:
    """Share of scene pairs (N, 2, 3 cube roots) that a light explains, and the light (3,), after `rounds`
    iterations."""
    gain = start.copy()
    x = np.empty(6)
    share = 0.0
    for iteration in range(rounds + 1):
        num = np.zeros(3)
        den = np.zeros(3)
        share = 0.0
        for i in range(scene.shape[0]):
            for side in range(2):
                fx, fy, fz = (
                    scene[i, side, 0] / gain[0],
                    scene[i, side, 1] / gain[1],
                    scene[i, side, 2] / gain[2],
                )
                x[3 * side] = 116.0 * lightness * fy
                x[3 * side + 1] = 500.0 * (fx - fy)
                x[3 * side + 2] = 200.0 * (fy - fz)
            best = np.inf
            at = 0
            swapped = 0
            for j in range(model.shape[0]):
                straight = 0.0
                crossed = 0.0
                for c in range(6):
                    e = x[c] - model[j, c]
                    straight += e * e
                    e = x[c] - model[j, (c + 3) % 6]
                    crossed += e * e
                if straight < best:
                    best = straight
                    at = j
                    swapped = 0
                if crossed < best:
                    best = crossed
                    at = j
                    swapped = 1
            k = np.exp(-0.5 * best / (sigma * sigma))
            share += k / scene.shape[0]
            for side in range(2):
                o = 3 * (side ^ swapped)
                fy = model[at, o] / (116.0 * lightness)
                fx = fy + model[at, o + 1] / 500.0
                fz = fy - model[at, o + 2] / 200.0
                num[0] += k * scene[i, side, 0] * fx
                den[0] += k * fx * fx
                num[1] += k * scene[i, side, 1] * fy
                den[1] += k * fy * fy
                num[2] += k * scene[i, side, 2] * fz
                den[2] += k * fz * fz
        if iteration < rounds:
            pull = prior * scene.shape[0]
            for c in range(3):
                gain[c] = (num[c] + pull * start[c]) / (den[c] + pull)
    return share, gain
