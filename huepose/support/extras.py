"""Which packages are installed, and the command that installs an extra of this package."""

from __future__ import annotations

import json
from importlib import metadata
from urllib.parse import unquote, urlparse

PACKAGE = "huepose"


def installed_version(package: str) -> str | None:
    """The version of a package; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def install_command(extra: str) -> str:
    """The pip command for an extra. It names the checkout or the wheel that was installed (PEP 610),
    because the package may be on no package index."""
    try:
        record = metadata.distribution(PACKAGE).read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        record = None
    origin = json.loads(record) if record else {}
    url = urlparse(origin.get("url", ""))
    if url.scheme != "file":
        return f"pip install '{PACKAGE}[{extra}]'"
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f"pip install {editable}'{unquote(url.path)}[{extra}]'"
