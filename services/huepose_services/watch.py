"""Observe a running pipeline from its own machine: its workers, their health, their messages.

It subscribes only to small messages, because observing a pipeline must not slow down its frames.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from huepose_protos.client import Reader
from huepose_protos.keys import last
from huepose_protos.messages import (
    CorrectionMessage,
    Estimates,
    HealthMessage,
    Message,
    ObjectEntry,
    ObjectsMessage,
    PerceptionRequest,
    PoseMessage,
)
from huepose_services.following import is_over
from huepose_services.runtime.running import Pipeline

_WINDOW_S = 3.0
_STALE_S = 2.5
"""Health comes once a second: an older one does not show the present state of the worker."""
_NOTICED_S = 0.1
"""How soon a request to stop is noticed."""
_KINDS = {PerceptionRequest: "request", Estimates: "estimates", CorrectionMessage: "correction"}


@dataclass(frozen=True)
class View:
    """The state of a pipeline. seen: whether any worker is there; rates: messages a second of `pose`,
    `request`, `estimates` and `correction`."""

    pipeline: Pipeline
    seen: bool
    health: dict[str, HealthMessage]
    silent: frozenset[str]
    """Workers that are there and have sent no health lately."""
    missing: tuple[str, ...]
    """Workers of the configuration that are not there."""
    objects: list[ObjectEntry] | None
    """None if no list of objects has arrived yet."""
    poses: dict[tuple[str, int], PoseMessage]
    rates: dict[str, float] = field(default_factory=dict)

    @property
    def well(self) -> bool:
        """Whether all workers are there and send health."""
        return self.seen and not self.missing and not self.silent


class Watch:
    """Listens to a pipeline; `view()` returns its present state."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        keys = ("health/*", "objects", "pose/**", "perception/request", "perception/estimates", "correction")
        self._reader = Reader(pipeline.endpoints, *(pipeline.key(key) for key in keys))
        self._health: dict[str, tuple[float, HealthMessage]] = {}
        self._were_there: set[str] = set()
        self._objects: list[ObjectEntry] | None = None
        self._poses: dict[tuple[str, int], tuple[float, PoseMessage]] = {}
        self._arrivals: dict[str, deque[float]] = {}
        self._since = time.monotonic()

    def look(self, seconds: float, stopping: Callable[[], bool] = lambda: False) -> None:
        """Listen for this time, or until `stopping` returns True."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0 and not stopping():
            message = self._reader.next(min(left, _NOTICED_S))
            if message is not None:
                self._take(message)
            self._forget_gone()

    def _forget_gone(self) -> None:
        """Drop what a worker sent before it ended: it does not hold for the worker that replaces it."""
        there = self._there()
        for worker in self._were_there - there:
            self._health.pop(worker, None)
            if worker == "tracker":
                self._poses.clear()
            elif worker == "reinit":
                self._objects = None
        self._were_there = there

    def _take(self, message: Message) -> None:
        now = time.monotonic()
        if isinstance(message, HealthMessage):
            self._health[message.worker] = (now, message)
        elif isinstance(message, ObjectsMessage):
            self._objects = message.objects
        elif isinstance(message, PoseMessage):
            self._poses[message.object, message.instance] = (now, message)
            self._count("pose", now)
        else:
            self._count(_KINDS.get(type(message), "other"), now)

    def _count(self, kind: str, now: float) -> None:
        arrivals = self._arrivals.setdefault(kind, deque())
        arrivals.append(now)
        while arrivals and now - arrivals[0] > _WINDOW_S:
            arrivals.popleft()

    def look_at_all(self, least_s: float, most_s: float) -> None:
        """Listen until every worker that is there has sent its health: at least least_s, at most most_s."""
        self.look(least_s)
        until = time.monotonic() + most_s - least_s
        while time.monotonic() < until and self._there() - set(self._health):
            self.look(0.1)

    def _there(self) -> set[str]:
        """The workers that are there; without `replay`, which sends no health."""
        return {last(key) for key in list(self._reader.live)} - {"replay"}

    def view(self) -> View:
        """The present state."""
        now = time.monotonic()
        there = self._there()
        fresh = {w: m for w, (when, m) in self._health.items() if now - when < _STALE_S}
        missing = tuple(w for w in self.pipeline.workers if w not in there)
        silent = frozenset(w for w in there if w not in fresh and now - self._since > _STALE_S)
        window_s = min(_WINDOW_S, max(now - self._since, 0.1))
        rates = {
            kind: sum(now - t <= window_s for t in arrivals) / window_s
            for kind, arrivals in self._arrivals.items()
        }
        poses = {
            key: m
            for key, (when, m) in sorted(self._poses.items())
            if now - when < _STALE_S and not is_over(m, self._objects)
        }
        health = {w: m for w, (_, m) in self._health.items() if w in there or w in fresh}
        seen = bool(self._reader.live)
        return View(self.pipeline, seen, health, silent, missing, self._objects, poses, rates)

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *error: object) -> None:
        self._reader.close()
