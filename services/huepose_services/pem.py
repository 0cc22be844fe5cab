"""Certificates and keys, and why a gateway is not reached with them: zenoh itself says only nothing."""

from __future__ import annotations

import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from huepose.support.errors import InputError

_WITHIN_S, _REFUSED_WITHIN_S = 3.0, 0.5


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


def why_unreachable(host: str, port: int, credentials: Credentials | None) -> str | None:
    """What is in the way to a gateway, in words; None where nothing is found."""
    try:
        link = socket.create_connection((host, port), timeout=_WITHIN_S)
    except socket.gaierror:
        return "no computer of this name is known"
    except ConnectionRefusedError:
        return "no program listens there"
    except TimeoutError:
        return "nothing answers there"
    except OSError as error:
        return error.strerror or str(error)
    with link:
        return _speaks_tls(link) if credentials is None else _refusal(link, host, credentials)


def _speaks_tls(link: socket.socket) -> str | None:
    anyone = ssl.create_default_context()
    anyone.check_hostname, anyone.verify_mode = False, ssl.CERT_NONE
    try:
        anyone.wrap_socket(link).close()
    except OSError:
        return None
    return "it speaks TLS: give --tls AUTHORITY CERTIFICATE KEY"


def _is_kept(secured: ssl.SSLSocket) -> bool:
    """Whether the other side holds the link: it says nothing before it is spoken to, and does not end it."""
    try:
        return bool(secured.recv(1))
    except ConnectionError:
        return False


def _refusal(link: socket.socket, host: str, credentials: Credentials) -> str | None:
    try:
        with credentials.context().wrap_socket(link, server_hostname=host) as secured:
            # With TLS 1.3 a refusal of our certificate comes after the handshake, otherwise there is silence.
            secured.settimeout(_REFUSED_WITHIN_S)
            with suppress(TimeoutError):
                if not _is_kept(secured):
                    return "it does not accept this certificate, or has no place for it"
    except ssl.SSLCertVerificationError as error:
        return f"its certificate is not accepted: {error.verify_message}"
    except ssl.SSLError as error:
        said = str(error.reason or error).replace("_", " ").lower()
        return f"it does not accept this certificate: {said}" if "alert" in said else f"no TLS there: {said}"
    except TimeoutError:
        return "no TLS there: no answer"
    except OSError as error:
        return f"no TLS there: {error.strerror or error}"
    return None
