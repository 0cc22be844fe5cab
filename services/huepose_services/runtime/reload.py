"""Read pipeline.yaml again while the pipeline runs (SIGHUP): which changes take effect at once, and which at
the next start.

Each worker takes the changes that concern it. A file with an error changes nothing.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec

from huepose.support.errors import InputError
from huepose_services.runtime.config import Config, RestartConfig
from huepose_services.runtime.config_file import load
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log

LIVE: dict[str, frozenset[str]] = {
    "tracker": frozenset({"tracker.max_age_ms"}),
    "reinit": frozenset({"objects", "reinit.rate_hz", "reinit.objects_per_tick", "reinit.deadline_ms"}),
    "gateway": frozenset(
        {"gateway.max_rate_hz", "gateway.sessions_per_reader", "gateway.tls.readers", "tracker.max_age_ms"}
    ),
    "huepose": frozenset(f"restarts.{name}" for name in RestartConfig.__struct_fields__),
}
"""The keys whose changes a worker, or the supervisor ("huepose"), takes over while it runs; where other
workers need them, it informs these."""

_OF_ALL = ("site", "bundles", "profile", "bus", "cpus", "camera.name", "hosts")
_OF_SOME = {"networks": ("detector", "segmenter"), "link": ("uplink", "downlink")}

TakeOver = Callable[[Config], list[str]]
"""Called with the new configuration: returns sentences on changes that cannot be made."""


def asked_again() -> Callable[[], bool]:
    """From now on SIGHUP does not end this process: the returned function says whether one came since its
    last call. But a SIGHUP because the terminal was closed acts as SIGTERM, unless nohup ignores it."""
    came, had_terminal = False, signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN and _has_terminal()

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True
        if had_terminal and not _has_terminal():
            signal.raise_signal(signal.SIGTERM)

    def answer() -> bool:
        nonlocal came
        was, came = came, False
        return was

    signal.signal(signal.SIGHUP, note)
    return answer


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY))
    except OSError:
        return False
    return True


def changed(before: Any, after: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Keys of a configuration that differ, each with a text with both values."""
    if isinstance(before, msgspec.Struct) and type(before) is type(after):
        for field in before.__struct_fields__:
            key = f"{name}.{field}" if name else field
            yield from changed(getattr(before, field), getattr(after, field), key)
    elif before != after:
        texts = [msgspec.json.encode(value).decode() for value in (before, after)]
        same = next((place for place, (a, b) in enumerate(zip(*texts, strict=False)) if a != b), 0)
        yield name, f"{name} ({' > '.join(_part(text, same) for text in texts)})"


def _part(text: str, same: int) -> str:
    """A text, or if it is long a part of it; same: how many characters at its beginning do not matter."""
    start = max(0, same - 20) if len(text) > 60 else 0
    text = f"...{text[start:]}" if start else text
    return text if len(text) <= 60 else f"{text[:57]}..."


class Reload:
    """Reads the configuration again, for one worker or the supervisor."""

    def __init__(
        self, worker: str, path: Path, config: Config, log: Log, health: Health | None = None
    ) -> None:
        self._worker, self._path, self._log, self._health = worker, path, log, health
        self._started = self._now = config

    def take_over(self, take_over: TakeOver) -> Config | None:
        """Read the file, take over what can be, and log what was and what was not. None: it has an error."""
        try:
            new = load(self._path, self._started.camera.name).at(self._started.host)
        except InputError as error:
            self._warn(f"{self._path} is not taken over: {error}")
            return None
        now = new
        if bool(self._started.objects) != bool(new.objects):
            # From all models to some, or back: the worker with the list of objects reports that it waits.
            now = msgspec.structs.replace(new, objects=self._now.objects)
        live = {key: text for key, text in changed(self._now, now) if self._is_live(key)}
        waits = [text for key, text in changed(self._started, new) if self._waits(key)]
        self._now = now
        # Also if nothing has changed: a restarted worker may lack changes that were made meanwhile.
        refused = take_over(new) if self._worker in LIVE else []
        if live:
            self._log.say(f"{self._path} was read again: {', '.join(live.values())}")
        later = f"changes that wait for the next start: {', '.join(waits)}" if waits else ""
        self._warn("; ".join([*refused, *([later] if later else [])]))
        return new

    def _warn(self, problem: str) -> None:
        if problem:
            self._log.warn(problem)
        if self._health is not None:
            self._health.warn_while("reload", problem or None)

    def _is_live(self, key: str) -> bool:
        return key in LIVE.get(self._worker, ())

    def _waits(self, key: str) -> bool:
        shared = [section for section, workers in _OF_SOME.items() if self._worker in workers]
        own = ("workers",) if self._worker == "huepose" else (self._worker, *_OF_ALL, *shared)
        return not self._is_live(key) and any(f"{key}.".startswith(f"{one}.") for one in own)
