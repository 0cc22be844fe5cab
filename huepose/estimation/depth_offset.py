"""Estimate the offset between depth and colour images from the outlines of known objects.

Cameras register depth to colour by a calibration, which ages, and their clocks differ; offsets of two to four
pixels are common, in published data as well. Poses follow depth, so their textures and outlines are then
displaced in the image. A single object may carry its label at another place than its mesh; a displacement
shared by the outlines of all objects of a frame is an offset of the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from huepose.estimation.outlines import FEWEST, RELATED_PX, edges_across, free_outline, smoothed
from huepose.geometry.arrays import Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import ReferenceModel
from huepose.support.words import beside

REACH_PX, STEP_PX = 6.0, 0.25
"""Search range and step, pixels."""

CLEAR_SIGMAS, CLEAR_PX = 4.0, 1.0
"""Least significance (standard errors) and length (pixels) of a clear offset."""


@dataclass(frozen=True)
class DepthOffset:
    """right_px, down_px: from the outlines in depth to the outlines in the image; sigmas: by how many
    standard errors the outlines agree better with this offset than without; points: number of outline
    points."""

    right_px: float
    down_px: float
    sigmas: float
    points: int

    @property
    def length_px(self) -> float:
        """Length of the offset."""
        return float(np.hypot(self.right_px, self.down_px))

    @property
    def clear(self) -> bool:
        """Whether there is clearly an offset."""
        return self.length_px >= CLEAR_PX and self.sigmas >= CLEAR_SIGMAS

    def __str__(self) -> str:
        way = beside(self.right_px, self.down_px, 1) or "about"
        return f"The image shows outlines {way} where depth has them"

    def said(self) -> str:
        """The offset and its consequence, in a sentence."""
        why = "poses follow depth; check how depth is registered to colour, and the camera matrix."
        return f"{self}: {why}"


def depth_offset(frame: RgbdFrame, placed: Sequence[tuple[ReferenceModel, Float64]]) -> DepthOffset | None:
    """The offset of a frame's colours from its depth, from objects with poses (4, 4) that were fitted to
    depth; None if too little of their outlines is free."""
    found = [free_outline(model, frame, T) for model, T in placed]
    found = [one for one in found if len(one[0]) >= FEWEST]
    if not found:
        return None
    normals = np.concatenate([n for _, n in found])
    edges = edges_across(smoothed(frame.color), np.concatenate([p for p, _ in found]), normals, REACH_PX)
    best = np.zeros(2)
    for step, reach in ((1.0, REACH_PX), (STEP_PX, 1.0)):
        ticks = np.arange(-reach, reach + step / 2, step)
        tried = best + np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        tried = tried[np.hypot(tried[:, 0], tried[:, 1]) <= REACH_PX]
        best = tried[int(np.argmax([edges.at(normals @ d).sum() for d in tried]))]
    gain = edges.at(normals @ best) - edges.at(np.zeros(len(normals)))
    error = float(gain.std()) * np.sqrt(RELATED_PX / len(gain)) + 1e-9
    return DepthOffset(float(best[0]), float(best[1]), float(gain.mean() / error), len(normals))
