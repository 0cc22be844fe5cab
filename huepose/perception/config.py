"""Settings of the default detector. Their defaults are those of a live pipeline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from huepose.support.errors import InputError

Source = Literal["keypoints", "views"]
SOURCES: tuple[Source, ...] = get_args(Source)

PICKED = 4
"""Most objects that are searched for in addition to the requested ones, because something new in the image
looks like them. Chosen for time."""


@dataclass(frozen=True)
class DetectorConfig:
    """sources: what proposes poses; proposals: most boxes of one object; min_score: a place where the
    object is with less than this probability is not worth an estimate; threads: objects that are searched
    for at the same time; remembering: frames come from one camera, in order, so that what has not changed
    is not processed again (`perception.memory`).

    Origin: chosen for time. Two boxes instead of three lose 0 to 3 % of the labels (first 1 / 2 / 5
    proposals in docs/detection_measured.md), and each box costs an estimate.
    """

    sources: tuple[Source, ...] = SOURCES
    proposals: int = 2
    min_score: float = 0.05
    threads: int = 1
    remembering: bool = False

    def __post_init__(self) -> None:
        if not self.sources or not set(self.sources) <= set(SOURCES):
            raise InputError(
                "detector: sources", found=str(self.sources), expected=f"some of {', '.join(SOURCES)}"
            )
        for name in ("proposals", "threads"):
            if getattr(self, name) < 1:
                raise InputError(f"detector: {name}", found=str(getattr(self, name)), expected="1 or more")
        if not 0.0 <= self.min_score < 1.0:
            raise InputError(
                "detector: min_score", found=str(self.min_score), expected="a probability from 0, under 1"
            )
