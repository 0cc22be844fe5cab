"""What a worker does, as its process sees it (`runtime.worker`)."""

from __future__ import annotations

from huepose_services.runtime.clock import SECOND
from huepose_services.runtime.config import Config

SOON_NS = SECOND // 50
"""How often to look for a frame that does not wake the loop, while something waits for it."""


class Work:
    """Made by `make(bus, config)` of a worker's module, warmed up when that returns."""

    finished = False
    """Set when there is nothing left to do: the worker then ends with exit code 0."""
    ready = True
    """Looked at after every step: as long as it is False, the worker does not say that it is ready (a camera
    before its first good frame)."""

    def step(self) -> None:
        """Do what is due: called when something arrived, when `due_ns` has come, and now and then."""
        raise NotImplementedError

    def due_ns(self) -> int | None:
        """When to be called at the latest; None to be called for arrivals only."""
        return None

    def reload(self, config: Config) -> list[str]:
        """Take over what of a changed configuration can be (`reload.LIVE`): sentences on what cannot."""
        return []

    def close(self) -> None:
        """Let go of all that is not on the bus: a camera that is not has to be plugged in anew."""
        return None
