"""The light model recovers the effect of the light, and outliers do not matter."""

from __future__ import annotations

import numpy as np

from huepose.refine.light import fit_light
from huepose.refine.samples import Samples, empty_samples


def samples(n: int, rng: np.random.Generator) -> Samples:
    s: Samples = empty_samples(n)
    s.which[:] = np.arange(n)
    normals = rng.normal(size=(n, 3))
    normals[:, 2] = -np.abs(normals[:, 2]) - 0.5
    s.normals[:] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return s


def run(s: Samples, texture: np.ndarray, image: np.ndarray, rounds: int = 5) -> tuple[np.ndarray, ...]:
    n = len(texture)
    residual, trust = np.zeros((n, 3)), np.zeros(n)
    correlation, rms = np.zeros(3), np.zeros(3)
    fit_light(n, s, np.ones(n), texture.astype(np.float32), image, rounds, residual, trust, correlation, rms)
    return residual, trust, correlation, rms


def test_gain_offset_and_shading_are_explained() -> None:
    rng = np.random.default_rng(0)
    s = samples(400, rng)
    texture = rng.uniform([10, -40, -40], [90, 40, 40], (400, 3))
    image = texture * [0.7, 0.8, 1.1] + [5.0, 12.0, -7.0]
    image[:, 0] += 6.0 * s.normals[:, 0]
    residual, trust, correlation, rms = run(s, texture, image)
    assert np.abs(residual).max() < 1.0
    assert trust.min() > 0.7
    assert (correlation > 0.97).all()
    assert (rms < 0.5).all()


def test_pixels_that_do_not_belong_to_the_object_are_not_trusted() -> None:
    rng = np.random.default_rng(1)
    s = samples(300, rng)
    texture = rng.uniform([10, -40, -40], [90, 40, 40], (300, 3))
    image = texture * 0.8 + rng.normal(0, 1.0, (300, 3))
    image[:60] = [50.0, 60.0, 60.0]
    residual, trust, _, _ = run(s, texture, image)
    assert np.median(trust[:60]) < 0.15
    assert np.median(trust[60:]) > 0.6
    assert np.median(np.abs(residual[60:])) < 1.5


def test_unrelated_colours_do_not_correlate() -> None:
    rng = np.random.default_rng(2)
    s = samples(500, rng)
    texture, image = rng.uniform(-40, 40, (2, 500, 3))
    _, _, correlation, _ = run(s, texture, image)
    assert (np.abs(correlation) < 0.2).all()


def test_even_surfaces_do_not_correlate() -> None:
    rng = np.random.default_rng(3)
    s = samples(500, rng)
    texture = np.full((500, 3), 30.0) + rng.normal(0, 0.3, (500, 3))
    _, _, correlation, _ = run(s, texture, texture.copy())
    assert (correlation < 0.1).all()
