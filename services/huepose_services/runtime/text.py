"""Text that leaves this process for the bus or a file of its own, both of which are UTF-8."""

from __future__ import annotations


def encodable(text: str) -> str:
    """The text with what no UTF-8 can hold written out, as the bytes of a file's name in another encoding,
    which Python has as surrogates (PEP 383).

    >>> encodable("caf\\udce9/x.png")
    'caf\\\\udce9/x.png'
    """
    return text.encode(errors="backslashreplace").decode()
