"""The two small protocols of perception: a detector gives boxes, a segmenter gives candidate masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.box import Box
from huepose.geometry.frame import RgbdFrame


@dataclass(frozen=True, eq=False)
class Detection:
    """An object by name, where it is, and how sure the detector is (higher is surer).

    T_cam_obj (4, 4): roughly its pose, if the detector knows."""

    object: str
    box: Box
    score: float
    T_cam_obj: Float64 | None = None


class Detector(Protocol):
    """Finds objects in a frame."""

    def detect(self, frame: RgbdFrame, names: Sequence[str]) -> list[Detection]:
        """Boxes of the named objects, best first; several of one name are several instances."""
        ...


class Segmenter(Protocol):
    """Outlines an object inside a box."""

    def segment(self, frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
        """One to three candidate masks (H, W), most likely first; they are judged together later."""
        ...
