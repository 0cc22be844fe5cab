"""Check certificates and keys in PEM files, and make TLS contexts of them."""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import NamedTuple

from huepose.support.errors import InputError

_HOLDS = {
    "authority": ("CERTIFICATE-----", "a certificate"),
    "certificate": ("CERTIFICATE-----", "a certificate"),
    "key": ("PRIVATE KEY-----", "a private key"),
    "revoked": ("X509 CRL-----", "a list of revoked certificates"),
}
"""For each kind of file: how the first line of its PEM block ends, and what the block is."""


def check_pem(what: str, name: str, path: Path) -> None:
    """Raises InputError unless the file can be read and has the right kind of PEM block. name: authority,
    certificate, key or revoked; what: the section or option that names the file."""
    ending, kind = _HOLDS[name]
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        begun, found = [], getattr(error, "strerror", None) or "no text"
    else:
        begun = [line for line in lines if line.startswith("-----BEGIN ")]
        found = begun[0].strip("-").removeprefix("BEGIN ") if begun else "nothing in PEM"
    if not any(line.rstrip().endswith(ending) for line in begun):
        raise InputError(
            f"{what}{name} {path}",
            found=found,
            expected=f"{kind} in PEM that this user can read",
            fix="docs/subscribers.md says how to make certificates.",
        )


def tls_context(
    purpose: ssl.Purpose, what: str, authority: str, certificate: str, key: str, revoked: str | None = None
) -> ssl.SSLContext:
    """A context for Python's own TLS, from files in PEM. Raises InputError about `what` for files that do
    not fit together."""
    try:
        context = ssl.create_default_context(purpose, cafile=authority)
        context.load_cert_chain(certificate, key)
        if revoked is not None:
            context.load_verify_locations(cafile=revoked)
            context.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF
    except (ssl.SSLError, OSError) as error:
        raise InputError(
            what,
            found=_in_words(error),
            expected="the authority's certificate, your own certificate, and its key",
            fix="docs/subscribers.md says how to make certificates.",
        ) from None
    return context


def _in_words(error: OSError) -> str:
    reason = str(getattr(error, "reason", None) or error)
    return "a key of another certificate" if reason == "KEY_VALUES_MISMATCH" else reason


class Credentials(NamedTuple):
    """The certificate files of a reader, in PEM."""

    authority: Path
    certificate: Path
    key: Path

    def context(self) -> ssl.SSLContext:
        """A context for Python's own TLS. Raises InputError for files that are not PEM, or do not fit
        together."""
        files = {name: str(path) for name, path in self._asdict().items()}
        for name, path in files.items():
            check_pem("--tls ", name, Path(path))
        return tls_context(ssl.Purpose.SERVER_AUTH, f"--tls {' '.join(files.values())}", **files)
