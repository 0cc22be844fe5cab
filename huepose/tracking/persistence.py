"""How often an object is searched for: after some rounds without success only now and then. An object that is
half occluded for seconds must not cost more than others."""

from __future__ import annotations

from dataclasses import dataclass

ENOUGH, AGAIN_AFTER_S = 3, 0.485
"""After ENOUGH rounds without success a search begins only AGAIN_AFTER_S seconds after the last one: half a
second, less half a frame of a camera at 30 Hz, whose frames do not come to the millisecond."""


@dataclass(frozen=True)
class Persistence:
    """seconds: time since the last search; rounds: how often all stages of a search failed; begun: the stage
    to try next."""

    seconds: float = 0.0
    rounds: int = 0
    begun: int = 0

    @property
    def enough(self) -> bool:
        """Whether all stages were tried often enough."""
        return self.rounds >= ENOUGH

    @property
    def resting(self) -> bool:
        """Whether no search begins in this frame."""
        return self.enough and self.seconds < AGAIN_AFTER_S

    def missed(self, seconds: float) -> Persistence:
        """In the next frame, `seconds` later, which does not show the object either."""
        return Persistence(self.seconds + seconds, self.rounds, self.begun)

    def reached(self, stage: int, stages: int, searched: bool = True) -> Persistence:
        """After a search that continues with `stage` of `stages`, after the last one with the first.
        searched: whether there was time for any stage."""
        seconds = 0.0 if searched else self.seconds
        return Persistence(seconds, self.rounds + (stage == stages), stage % stages)
