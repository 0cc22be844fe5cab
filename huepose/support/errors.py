"""Errors for users: what was read, what was found, what was expected, what to do."""

from __future__ import annotations

from types import UnionType


class InputError(ValueError):
    """Wrong usage or bad input: the command line prints it as one paragraph and exits with 2.

    >>> print(InputError("obj.mtl", found="no texture", expected="map_Kd", fix="Export again with textures."))
    obj.mtl: found no texture; expected map_Kd. Export again with textures.
    """

    def __init__(self, what: object, *, found: str = "", expected: str = "", fix: str = "") -> None:
        parts = [f"found {found}" if found else "", f"expected {expected}" if expected else ""]
        facts = "; ".join(p for p in parts if p)
        text = f"{what}: {facts}." if facts else f"{what}."
        super().__init__(f"{text} {fix}".strip())
        self.what, self.found, self.expected, self.fix = str(what), found, expected, fix


def require(value: object, kind: type | UnionType, what: object, expected: str, fix: str = "") -> None:
    """Raises InputError if a value from a caller has another type.

    >>> require((1, 2), str, "a name", "text")
    Traceback (most recent call last):
    huepose.support.errors.InputError: a name: found tuple; expected text.
    """
    if not isinstance(value, kind):
        found = "None" if value is None else type(value).__name__
        raise InputError(what, found=found, expected=expected, fix=fix)
