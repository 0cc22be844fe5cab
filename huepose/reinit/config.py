"""What can be set about the re-initialisation loop."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.support.errors import InputError


@dataclass(frozen=True)
class ReinitConfig:
    """period_ms: of the requests; objects_per_request: most that one asks for; deadline_ms: after it an
    unanswered request is counted and another one made; give_up_ms: how long a correction is repeated;
    stale_ms: a tracked object that was not looked at for so long gets a turn even while others are lost.

    acquire_quality: one estimate over it is enough to acquire; least_quality: one under it is never used.
    correct_margin: a pose that disagrees must explain the image this much better than the tracked one (scores
    on the same pixels); doubtful_margin: the same while the object is SUSPECT.
    """

    period_ms: float = 200.0
    objects_per_request: int = 2
    deadline_ms: float = 600.0
    give_up_ms: float = 2000.0
    stale_ms: float = 1000.0
    acquire_quality: float = 0.9
    least_quality: float = 0.2
    correct_margin: float = 0.1
    doubtful_margin: float = 0.03

    def __post_init__(self) -> None:
        for name in ("period_ms", "deadline_ms", "give_up_ms", "stale_ms"):
            if getattr(self, name) <= 0:
                raise InputError(f"reinit: {name}", found=str(getattr(self, name)), expected="more than 0 ms")
        if self.objects_per_request < 1:
            raise InputError(
                "reinit: objects_per_request", found=str(self.objects_per_request), expected="1 or more"
            )
        if not 0.0 <= self.least_quality <= self.acquire_quality <= 1.0:
            raise InputError(
                "reinit: qualities",
                found=f"least_quality {self.least_quality}, acquire_quality {self.acquire_quality}",
                expected="0 <= least_quality <= acquire_quality <= 1",
            )
