"""First sightings that were not certain enough to acquire an object: each waits for a second look that
agrees, which comes at once."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.estimation.types import PoseEstimate
from huepose.reinit.judge import pose_of, same_sight
from huepose.reinit.types import ObjectSlot

SIGHTING_S = 1.0
"""A sighting is kept this long for a second one, or until its object had another turn, seconds."""


@dataclass(frozen=True, eq=False)
class _Sighting:
    estimate: PoseEstimate
    stamp_ns: int


class Sightings:
    """What was sighted of each object since it had a pose, and for which of them another look is due."""

    def __init__(self) -> None:
        self._kept: dict[str, list[_Sighting]] = {}
        self._looks: dict[str, int] = {}
        """The last request that looked again, 0 while one is to."""

    def due(self) -> set[str]:
        """Objects that are to be looked at again at once: one time, and by their turns after that."""
        return {name for name, request in self._looks.items() if request == 0}

    def asked(self, name: str, request: int) -> None:
        """A request asks for an object."""
        if self._looks.get(name) == 0:
            self._looks[name] = request

    def recent(self, name: str, now_ns: int) -> bool:
        """Whether an object was sighted a moment ago."""
        newest_ns = max((s.stamp_ns for s in self._kept.get(name, [])), default=0)
        return now_ns - newest_ns <= SIGHTING_S * 1e9

    def confirming(
        self, slot: ObjectSlot, estimate: PoseEstimate, stamp_ns: int, request: int, wait_s: float
    ) -> PoseEstimate | None:
        """The surest earlier sighting with which an estimate of a request's answer agrees; without one it is
        kept as a sighting itself. wait_s: how long a sighting waits at least."""
        wait_ns = max(SIGHTING_S, wait_s) * 1e9
        kept = [s for s in self._kept.get(slot.object, []) if abs(stamp_ns - s.stamp_ns) <= wait_ns]
        agreeing = [
            s.estimate
            for s in kept
            if s.stamp_ns != stamp_ns
            and same_sight(pose_of(s.estimate), pose_of(estimate), (stamp_ns - s.stamp_ns) * 1e-9, slot)
        ]
        if agreeing:
            return max(agreeing, key=lambda e: e.quality)
        self._kept[slot.object] = [*kept, _Sighting(estimate, stamp_ns)]
        if self._looks.get(slot.object) != request:
            self._looks[slot.object] = 0
        return None

    def forget(self, name: str) -> None:
        """An object was acquired, or is searched anew."""
        self._kept.pop(name, None)
        self._looks.pop(name, None)

    def clear(self) -> None:
        """Nothing was sighted: a new epoch."""
        self._kept.clear()
        self._looks.clear()
