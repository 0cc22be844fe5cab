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
    """The name of an object, its box, and the detector's score (higher is more certain).

    T_cam_obj (4, 4): a rough pose, if the detector has one."""

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
    """Segments an object inside a box."""

    def segment(self, frame: RgbdFrame, box: Box, diameter_m: float) -> list[Bool]:
        """One to three candidate masks (H, W), most likely first; they are judged together later."""
        ...
