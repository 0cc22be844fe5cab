"""Corrections in flight: numbered for each instance, and repeated until a published pose shows that they were
applied.

The sequence number of a correction is the time at which it was made, in ns: so it is above all numbers of an
earlier loop, and does not depend on other messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from huepose.tracking.types import Correction, Key, TrackedPose


@dataclass
class _Sent:
    correction: Correction
    first_ns: int
    last_ns: int


class Outbox:
    """Holds at most one correction per instance: a newer one replaces an older one."""

    def __init__(self) -> None:
        self._sent: dict[Key, _Sent] = {}
        self._seq: dict[Key, int] = {}

    def next_seq(self, key: Key, now_ns: int) -> int:
        """Next sequence number of an instance: above all used ones, also those of an earlier loop."""
        self._seq[key] = max(self._seq.get(key, 0) + 1, now_ns)
        return self._seq[key]

    def send(self, correction: Correction, now_ns: int) -> None:
        """Store a correction that is sent now."""
        self._sent[correction.key] = _Sent(correction, now_ns, now_ns)

    def acknowledge(self, tracks: Mapping[Key, TrackedPose]) -> None:
        """Drop the corrections that published poses contain."""
        for key in list(self._sent):
            track = tracks.get(key)
            if track is not None and track.applied_correction_seq >= self._sent[key].correction.seq:
                del self._sent[key]

    def give_up(self, now_ns: int, after_ns: float) -> list[Correction]:
        """Drop and return the corrections that were repeated for too long."""
        old = [key for key, sent in self._sent.items() if now_ns - sent.first_ns > after_ns]
        return [self._sent.pop(key).correction for key in old]

    def due(self, now_ns: int, period_ns: float) -> list[Correction]:
        """The corrections to send again now."""
        out = []
        for sent in self._sent.values():
            if now_ns - sent.last_ns >= period_ns:
                sent.last_ns = now_ns
                out.append(sent.correction)
        return out

    def arriving(self, now_ns: int, patience_ns: float) -> tuple[Key, ...]:
        """Instances whose correction was first sent at most `patience_ns` ago; after that the tracker
        probably could not use it."""
        return tuple(key for key, sent in self._sent.items() if now_ns - sent.first_ns <= patience_ns)

    @property
    def instances(self) -> tuple[Key, ...]:
        """Instances with a correction on its way."""
        return tuple(self._sent)

    def forget(self, name: str) -> None:
        """Drop the corrections of an object."""
        for key in [k for k in self._sent if k[0] == name]:
            del self._sent[key]

    def clear(self) -> None:
        """Drop everything: a new epoch has other instances."""
        self._sent.clear()
        self._seq.clear()
