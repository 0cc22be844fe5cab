"""The one error of the wire."""

from __future__ import annotations


class WireError(ValueError):
    """Bytes from the bus that cannot be believed. `reason` is one short line for a counter and the log."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason
