"""Compiling the tracker's kernels ahead of the first frame."""

from __future__ import annotations

import numpy as np

from huepose.geometry import se3
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.tracking.config import TrackerConfig
from huepose.tracking.step import Anchor, Subject, advance

SIDE = 96


def warm_up(subject: Subject, config: TrackerConfig) -> None:
    """Take one step, with everything that a difficult one needs, on a made-up frame."""
    distance = 4.0 * subject.surface.radius_m
    camera = Camera(SIDE, SIDE, (SIDE - 1) / 2, (SIDE - 1) / 2, SIDE, SIDE)
    T = se3.make(np.eye(3), np.array([0.0, 0.0, distance]) - subject.surface.arrays.centre)
    color = np.random.default_rng(0).integers(0, 255, (SIDE, SIDE, 3), dtype=np.uint8)
    depth = np.full((SIDE, SIDE), distance, np.float32)
    before = RgbdFrame(color, depth, camera)
    after = RgbdFrame(color, depth, camera, 1, 33_000_000)
    advance(subject, Anchor(T, np.zeros(6), before, 2.0), after, config)
