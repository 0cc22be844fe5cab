"""Shared by the tests of search and memory: a second pose, frames with noise, a count of coded windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.geometry import RgbdFrame, se3
from huepose.perception import windows
from huepose.propose.view_codes import codes_of_windows


@pytest.fixture(scope="session")
def beside(standing: np.ndarray) -> np.ndarray:
    """A second pose on the same table, rotated about the object's upright axis."""
    moved = standing @ se3.make(se3.rotation_exp(np.array([0.0, 0.0, 2.0])), np.zeros(3))
    moved[0, 3] += 0.17
    return moved


def noisy(frame: RgbdFrame, seed: int) -> RgbdFrame:
    """The same view with other noise."""
    rng = np.random.default_rng(seed)
    color = np.clip(frame.color + rng.normal(0.0, 3.0, frame.color.shape), 0, 255).astype(np.uint8)
    depth = frame.depth * (1.0 + rng.normal(0.0, 0.002, frame.depth.shape)).astype(np.float32)
    return replace(frame, color=color, depth=depth)


@pytest.fixture
def coded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many windows were coded in each call of the network."""
    counts: list[int] = []

    def counted(colors: np.ndarray, reliefs: np.ndarray) -> np.ndarray:
        counts.append(len(colors))
        return codes_of_windows(colors, reliefs)

    monkeypatch.setattr(windows, "codes_of_windows", counted)
    return counts
