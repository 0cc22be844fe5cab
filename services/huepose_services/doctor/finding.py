"""What a check found: fine, not needed, to be noted, or to be mended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "none", "note", "bad"]
_MARKS = {"ok": "OK  ", "none": "-   ", "note": "NOTE", "bad": "BAD "}


@dataclass(frozen=True)
class Finding:
    """One line. `none`: it is not there, and nothing needs it; `note`: works, but could be better."""

    subject: str
    state: State
    found: str
    fix: str = ""

    @property
    def bad(self) -> bool:
        """Whether something does not work."""
        return self.state == "bad"

    def line(self) -> str:
        """As it is printed."""
        text = f"{_MARKS[self.state]} {self.subject:16s} {self.found}"
        return f"{text}\n{'':22s}-> {self.fix}" if self.fix else text
