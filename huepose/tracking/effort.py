"""How long an object is searched for: after some rounds in vain only now and then. One that is half hidden
for seconds must not cost more than others."""

from __future__ import annotations

from dataclasses import dataclass, replace

ENOUGH, TRY_AGAIN_AFTER = 3, 15
"""After ENOUGH rounds in vain a search begins only TRY_AGAIN_AFTER frames after the last one."""


@dataclass(frozen=True)
class Effort:
    """frames: those since the object was searched for last; rounds: how often all stages of a search were in
    vain; begun: the stage to try next."""

    frames: int = 0
    rounds: int = 0
    begun: int = 0

    @property
    def enough(self) -> bool:
        """Whether all stages were tried often enough."""
        return self.rounds >= ENOUGH

    @property
    def resting(self) -> bool:
        """Whether no search begins in this frame."""
        return self.enough and self.frames < TRY_AGAIN_AFTER

    def missed(self) -> Effort:
        """In the next frame, in which it is missed as well."""
        return replace(self, frames=self.frames + 1)

    def reached(self, stage: int, stages: int, searched: bool = True) -> Effort:
        """After a search of so many stages that is to go on with this one, after the last with the first.
        searched: whether there was time for any."""
        frames = 0 if searched else self.frames
        return Effort(frames, self.rounds + (stage == stages), stage % stages)
