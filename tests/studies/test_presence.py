from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.logistic import Logistic, belief
from huepose.believe.presence import Sight, features
from huepose.geometry import Camera, RgbdFrame
from studies.presence.fit import (
    SeenPlaces,
    chances,
    fit_presence,
    of_another_camera,
    smaller_frame,
    specked,
)

LAW = Logistic(
    -9.0,
    {
        **{"fit": 6.0, "color": 4.0, "free_rim": 5.0, "ends": 5.0, "likeness": 20.0},
        **{"verified": 0.5, "pixels": 0.7},
    },
)


def drawn(frames: int, seed: int, law: Logistic = LAW) -> list[SeenPlaces]:
    """Frames of twelve places each; `law` gives the probability that the object is there."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(frames):
        sights = []
        for _ in range(12):
            fit, texture, rim, goes_on = rng.uniform(0.0, 1.0, 4)
            likeness = rng.uniform(0.0, 0.35)
            verified, pixels = rng.uniform(-5.0, 5.0), int(rng.integers(5, 400))
            sights.append(Sight(fit, texture, 36.0, rim, goes_on, likeness, verified, pixels))
        names = tuple("abcdefghijkl")
        certain = rng.choice([0.0, 2.0], 12)
        seen = SeenPlaces(names, tuple(sights), certain, np.zeros(12, bool))
        out.append(replace(seen, there=rng.random(12) < chances(seen, law)))
    return out


def test_the_fit_recovers_the_weights_of_constructed_frames_from_a_poor_start() -> None:
    start = Logistic(
        -1.0,
        {
            **{"fit": 1.0, "color": 1.0, "free_rim": 1.0, "ends": 1.0, "likeness": 1.0},
            **{"verified": 0.1, "pixels": 0.1},
        },
    )
    found = fit_presence(drawn(200, 0), start)
    for name in LAW.factors:
        assert found.factors[name] == pytest.approx(LAW.factors[name], rel=0.35), name
    fresh = drawn(50, 1)
    stated = np.concatenate([chances(f, found) for f in fresh])
    true = np.concatenate([chances(f, LAW) for f in fresh])
    assert np.abs(stated - true).mean() < 0.03


def test_presence_increases_with_every_feature() -> None:
    sight = Sight(0.7, 0.4, 36.0, 0.2, 0.1, 0.25, 3.0, 100)
    known = {
        "fit": 0.7,
        "color": -0.5,
        "free_rim": 0.8,
        "ends": -0.1,
        "likeness": 0.25,
        "verified": 3.0,
        "pixels": np.log(100.0),
    }
    assert features(sight) == pytest.approx(known)
    assert features(replace(sight, contrast=0.0))["color"] == 0.0  # a plain object has no colour evidence
    assert set(belief("presence").factors) == set(known)
    assert set(belief("place").factors) == set(known) - {"verified"}
    assert min(*belief("presence").factors.values(), *belief("place").factors.values()) >= 0.0


def test_a_smaller_frame_has_a_scaled_camera_and_specks_keep_other_depth() -> None:
    camera = Camera(300.0, 300.0, 79.5, 59.5, 160, 120)
    frame = RgbdFrame(np.full((120, 160, 3), 90, np.uint8), np.full((120, 160), 1.5, np.float32), camera)
    small = smaller_frame(frame, 0.5)
    assert (small.camera.width, small.camera.height, small.camera.fx) == (80, 60, 150.0)
    assert small.depth.shape == (60, 80)
    assert np.all(small.depth == np.float32(1.5))
    depth = specked(frame.depth, np.random.default_rng(0))
    as_it_was = depth == np.float32(1.5)
    assert 0.5 < as_it_was.mean() < 1.0
    assert (depth == 0.0).any()
    assert ((depth > 0.0) & ~as_it_was).any()


def test_another_camera_changes_colours_only() -> None:
    color = np.zeros((20, 30, 3), np.uint8)
    color[:, 15:] = (200, 60, 30)
    seen = of_another_camera(color, np.random.default_rng(0))
    assert seen.shape == color.shape
    assert seen.dtype == np.uint8
    left, right = seen[:, :15].reshape(-1, 3), seen[:, 15:].reshape(-1, 3)
    assert len(np.unique(left, axis=0)) == len(np.unique(right, axis=0)) == 1
    assert right[0].sum() > left[0].sum() + 60  # bright stays brighter
    assert np.abs(right[0].astype(int) - (200, 60, 30)).max() > 5
