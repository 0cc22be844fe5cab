"""Settings of the re-initialisation loop."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.support.errors import InputError


@dataclass(frozen=True)
class ReinitConfig:
    """period_ms: time between requests.
    objects_per_request: most objects in one request.
    deadline_ms: an unanswered request expires after this time, and another one is made.
    give_up_ms: a correction is repeated at most this long.
    stale_ms: a tracked object that was not looked at for this long gets a place even while others are lost.
    eager_ms: a missing object is searched for in every request for this long.
    patient_ms: the time between two searches for it after that.
    acquire_quality: quality from which an estimate without a comparison corrects a doubtful pose, and
    presence from which one estimate is enough to acquire an object.
    least_quality: estimates with a lower quality are never used.
    correct_margin: how much higher than the score of the tracked pose, on the same pixels, that of a
    disagreeing estimate must be.
    doubtful_margin: the same while the object is SUSPECT."""

    period_ms: float = 200.0
    objects_per_request: int = 2
    deadline_ms: float = 600.0
    give_up_ms: float = 2000.0
    stale_ms: float = 1000.0
    eager_ms: float = 5000.0
    patient_ms: float = 1000.0
    acquire_quality: float = 0.9
    least_quality: float = 0.2
    correct_margin: float = 0.1
    doubtful_margin: float = 0.03

    def __post_init__(self) -> None:
        for name in ("period_ms", "deadline_ms", "give_up_ms", "stale_ms", "eager_ms", "patient_ms"):
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
