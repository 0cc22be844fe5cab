"""Downloads of known networks: with progress, taken up again where they broke off, and checked at the end."""

from __future__ import annotations

import http.client
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import TextIO

from huepose.perception.sessions import digest
from huepose.support.errors import InputError
from huepose.support.progress import Status
from huepose_services.catalogue import Entry

_BLOCK = 1 << 16
_TIMEOUT_S = 20.0


def fetch(entry: Entry, url: str | None = None, out: TextIO | None = None) -> Path:
    """The file of a network, downloaded unless it is there already. `url` replaces the known one.

    Raises InputError when it cannot be had, or is not what it should be: then it is thrown away."""
    network, path, out = entry.network, entry.path, out or sys.stderr
    if network.sha256 is None:
        raise InputError(
            f"network '{network.name}'",
            found="no digest that tells a right file from a wrong one",
            expected=f"a file of {network.source}",
            fix=f"Download or export it yourself, then: huepose models add FILE --name {network.name}",
        )
    if path.is_file():
        if digest(path) == network.sha256:
            return path
        raise InputError(
            path,
            found="another file of that name",
            expected=f"SHA-256 {network.sha256}",
            fix="Remove it, then fetch it again.",
        )
    url = url or network.url
    if url is None:
        raise InputError(
            f"network '{network.name}'",
            found="no address",
            fix="Give one: huepose models fetch NAME --from URL",
        )
    part = path.with_suffix(".part")
    part.parent.mkdir(parents=True, exist_ok=True)
    try:
        _download(url, part, network.size_bytes, out)
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise InputError(
            url,
            found=" ".join(str(error).split()) or type(error).__name__,
            expected=f"the network {network.name}",
            fix=f"Try again: what has come is kept. Offline, put the file to {path} by hand.",
        ) from None
    if (found := digest(part)) != network.sha256:
        part.unlink()
        raise InputError(
            url,
            found=f"SHA-256 {found}",
            expected=network.sha256,
            fix="It was damaged on the way, or has been replaced there; it was thrown away.",
        )
    part.replace(path)
    return path


def _download(url: str, part: Path, size_bytes: int | None, out: TextIO) -> None:
    """Everything behind what `part` has already."""
    have = part.stat().st_size if part.is_file() else 0
    if size_bytes is not None and have >= size_bytes:
        return
    # Any scheme: what comes is taken only with the right digest.
    request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})  # noqa: S310  # see above
    try:
        answer = urllib.request.urlopen(request, timeout=_TIMEOUT_S)  # noqa: S310  # see above
    except urllib.error.HTTPError as error:
        if error.code == 416 and have:  # nothing is left to send
            return
        raise
    with answer:
        # A server that knows no ranges sends all of it, from the start.
        goes_on = have > 0 and answer.status == 206
        done = have if goes_on else 0
        total = size_bytes or done + int(answer.headers.get("Content-Length") or 0)
        name, status = part.stem, Status(out)
        status.line(f"{name}: downloading {total / 1e6:.1f} MB" if total else f"{name}: downloading")
        with part.open("ab" if goes_on else "wb") as file:
            while block := answer.read(_BLOCK):
                file.write(block)
                done += len(block)
                share = f" of {total / 1e6:.1f} MB, {100 * done / total:.0f} %" if total else " MB"
                status.show(f"{name}: {done / 1e6:.1f}{share}")
    if total and done < total:
        raise OSError(f"it broke off after {done} of {total} bytes")
    status.line(f"{name}: {done / 1e6:.1f} MB are here")
