from dataclasses import replace

import numpy as np
import pytest

from huepose.believe.logistic import Logistic
from huepose.believe.presence import Sight, features, presence_fit
from studies.presence.fit import SeenPlaces, chances, fit_presence

LAW = Logistic(-8.0, {"fit": 6.0, "violation": 1.0, "texture": 3.0, "free_rim": 5.0, "hue": 0.7})


def drawn(frames: int, seed: int, law: Logistic = LAW) -> list[SeenPlaces]:
    """Frames of twelve places each, whose objects are there with the chance that the law says; in each frame
    another light, in which what is there looks as its model does and what is not looks like anything."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(frames):
        light = rng.normal(0.0, 15.0, 2)
        sights = []
        for k in range(12):
            own = rng.normal(0.0, 25.0, 2)
            shown = own + light + rng.normal(0.0, 4.0, 2) if k % 2 else rng.normal(0.0, 25.0, 2)
            hues = np.tile([1.0, *own, *shown], (20, 1))
            sights.append(Sight(*rng.uniform(0.0, 1.0, 3), rng.uniform(0.0, 1.0), hues))
        names = tuple("abcdefghijkl")
        certain = rng.choice([0.0, 2.0], 12)
        seen = SeenPlaces(names, tuple(sights), certain, np.zeros(12, bool))
        out.append(replace(seen, there=rng.random(12) < chances(seen, law)))
    return out


def test_the_weights_behind_constructed_frames_are_found_from_a_poor_start() -> None:
    start = Logistic(-1.0, {"fit": 1.0, "violation": 0.0, "texture": 1.0, "free_rim": 1.0, "hue": 0.1})
    found = fit_presence(drawn(200, 0), start)
    for name in ("fit", "texture", "free_rim", "hue"):
        assert found.factors[name] == pytest.approx(LAW.factors[name], rel=0.35), name
    fresh = drawn(50, 1)
    stated = np.concatenate([chances(f, found) for f in fresh])
    true = np.concatenate([chances(f, LAW) for f in fresh])
    assert np.abs(stated - true).mean() < 0.03


def test_everything_that_is_seen_speaks_for_presence_the_more_of_it_there_is() -> None:
    sight = Sight(0.7, 0.1, 0.4, 0.2, np.zeros((0, 5)))
    known = {"fit": 0.7, "violation": 0.1, "texture": 0.4, "free_rim": 0.8, "hue": 1.5}
    assert features(sight, 1.5) == pytest.approx(known)
    shipped = presence_fit()
    assert set(shipped.factors) == set(known)
    assert min(shipped.factors.values()) >= 0.0
