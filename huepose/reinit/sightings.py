"""First sightings that were not certain enough to acquire an object: each waits for a second one that agrees,
which is requested at once."""

from __future__ import annotations

from dataclasses import dataclass

from huepose.estimation.types import PoseEstimate
from huepose.reinit.judge import pose_of, same_sighting
from huepose.reinit.types import ObjectSlot

SIGHTING_S = 1.0
"""A sighting waits this long for a second one, seconds, or longer, until its object had another turn."""


@dataclass(frozen=True, eq=False)
class _Sighting:
    estimate: PoseEstimate
    stamp_ns: int


class Sightings:
    """The sightings of each object since it last had a pose, and the objects that should be requested
    again."""

    def __init__(self) -> None:
        self._kept: dict[str, list[_Sighting]] = {}
        self._looks: dict[str, int] = {}
        """The number of the last request for a second look; 0 if it is still to be made."""

    def due(self) -> set[str]:
        """Objects to request again at once: one time only, and in their turns after that."""
        return {name for name, request in self._looks.items() if request == 0}

    def asked(self, name: str, request: int) -> None:
        """Note that a request asks for an object."""
        if self._looks.get(name) == 0:
            self._looks[name] = request

    def recent(self, name: str, now_ns: int) -> bool:
        """Whether an object was sighted a moment ago."""
        newest_ns = max((s.stamp_ns for s in self._kept.get(name, [])), default=0)
        return now_ns - newest_ns <= SIGHTING_S * 1e9

    def confirming(
        self, slot: ObjectSlot, estimate: PoseEstimate, stamp_ns: int, request: int, wait_s: float
    ) -> PoseEstimate | None:
        """The earlier sighting with the highest quality that agrees with an estimate of the answer to
        `request`; without one, the estimate is kept as a sighting itself, and None returned. wait_s: how long
        a sighting waits at least."""
        wait_ns = max(SIGHTING_S, wait_s) * 1e9
        kept = [s for s in self._kept.get(slot.object, []) if abs(stamp_ns - s.stamp_ns) <= wait_ns]
        agreeing = [
            s.estimate
            for s in kept
            if s.stamp_ns != stamp_ns
            and same_sighting(pose_of(s.estimate), pose_of(estimate), (stamp_ns - s.stamp_ns) * 1e-9, slot)
        ]
        if agreeing:
            return max(agreeing, key=lambda e: e.quality)
        self._kept[slot.object] = [*kept, _Sighting(estimate, stamp_ns)]
        if self._looks.get(slot.object) != request:
            self._looks[slot.object] = 0
        return None

    def forget(self, name: str) -> None:
        """Forget an object: it was acquired, or is searched for again."""
        self._kept.pop(name, None)
        self._looks.pop(name, None)

    def clear(self) -> None:
        """Forget everything: a new epoch."""
        self._kept.clear()
        self._looks.clear()
