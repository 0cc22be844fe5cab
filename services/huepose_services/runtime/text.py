"""Text for the bus and for files, both of which are UTF-8."""

from __future__ import annotations


def encodable(text: str) -> str:
    """The text with escapes for characters that UTF-8 cannot hold, such as the surrogates with which Python
    represents file names in another encoding (PEP 383).

    >>> encodable("caf\\udce9/x.png")
    'caf\\\\udce9/x.png'
    """
    return text.encode(errors="backslashreplace").decode()
