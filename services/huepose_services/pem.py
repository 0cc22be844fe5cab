"""Certificates and keys: whether they can be used."""

from __future__ import annotations

import ssl
from dataclasses import dataclass
from pathlib import Path

from huepose.support.errors import InputError


def check_pem(what: str, path: Path) -> None:
    """Raises InputError unless it is a file that can be read and looks like PEM."""
    try:
        begins = path.read_text()[:4096]
    except (OSError, UnicodeDecodeError) as error:
        begins, found = "", getattr(error, "strerror", None) or "no text"
    else:
        found = "something else"
    if "-----BEGIN" not in begins:
        raise InputError(
            f"{what} {path}",
            found=found,
            expected="a file in PEM that this user can read",
            fix="docs/subscribers.md says how to make certificates.",
        )


def tls_context(
    purpose: ssl.Purpose, what: str, authority: str, certificate: str, key: str, revoked: str | None = None
) -> ssl.SSLContext:
    """Files in PEM for Python's own TLS. Raises InputError about `what` for files that do not fit."""
    try:
        context = ssl.create_default_context(purpose, cafile=authority)
        context.load_cert_chain(certificate, key)
        if revoked is not None:
            context.load_verify_locations(cafile=revoked)
            context.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF
    except (ssl.SSLError, OSError) as error:
        raise InputError(
            what,
            found=getattr(error, "reason", None) or str(error),
            expected="an authority's certificate, one's own, and the key that belongs to it",
            fix="docs/subscribers.md says how to make certificates.",
        ) from None
    return context


@dataclass(frozen=True)
class Credentials:
    """What a reader shows: files in PEM."""

    authority: Path
    certificate: Path
    key: Path

    def context(self) -> ssl.SSLContext:
        """Them as Python's own TLS knows them. Raises InputError for files that are none, or do not fit."""
        files = {name: str(path) for name, path in vars(self).items()}
        for name, path in files.items():
            check_pem(f"--tls {name}", Path(path))
        return tls_context(ssl.Purpose.SERVER_AUTH, f"--tls {' '.join(files.values())}", **files)
