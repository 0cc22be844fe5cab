"""The address of a gateway or a worker, and why it is not reached: zenoh itself does not say."""

from __future__ import annotations

import re
import socket
import ssl
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from huepose_protos.local import why_only_noted

Files = tuple[Path | str, Path | str, Path | str]
"""Authority, certificate and key, in PEM."""

PORT = 7447
"""The default port of a gateway."""
_LOCAL = "unixsock-stream/"
_WITHIN_S, _REFUSED_WITHIN_S = 3.0, 0.5
_ROUNDS = 3
"""Rounds after which both sides have sent all messages of a TLS handshake."""


def address_of(text: str) -> tuple[str, int]:
    """Host and port of `HOST` or `HOST:PORT`, perhaps after `tcp/` or `tls/`. Raises ValueError.

    >>> address_of("robot.local"), address_of("tls/[::1]:7000")
    (('robot.local', 7447), ('::1', 7000))
    """
    match = re.fullmatch(r"(?:(?:tcp|tls)/)?(\[[^\]]+\]|[^\[\]:/\s]+)(?::(\d{1,5}))?", text)
    if match is None or int(match[2] or PORT) > 65_535:
        raise ValueError(
            f"the gateway: found {text!r}; expected HOST, HOST:PORT, tcp/HOST:PORT or tls/HOST:PORT"
        )
    return match[1].strip("[]"), int(match[2] or PORT)


def endpoint_of(text: str, tls: bool = False) -> str:
    """An address as a zenoh endpoint; tls: whether a bare host means TLS. Raises ValueError.

    >>> endpoint_of("robot.local"), endpoint_of("tls/[::1]:7000"), endpoint_of("unixsock-stream//run/x")
    ('tcp/robot.local:7447', 'tls/[::1]:7000', 'unixsock-stream//run/x')
    """
    kind, slash, _ = text.partition("/")
    if slash and kind not in ("tcp", "tls") and re.fullmatch(r"[a-z][a-z0-9_-]*", kind):
        return text
    host, port = address_of(text)
    kind = kind if slash else "tls" if tls else "tcp"
    return f"{kind}/{f'[{host}]' if ':' in host else host}:{port}"


def why_unreached(
    endpoints: Sequence[str], context: ssl.SSLContext | None, shown: Files | None = None
) -> str:
    """Why the first of these endpoints is not reached, in words; may take seconds. context: the reader's, for
    TLS; shown: the files that the context was made from, which are also checked alone."""
    why = _why_not_reached(endpoints, context)
    fault = None if shown is None else fault_of(*shown)
    return why if shown is None or fault is None else f"{why}. A check of {shown[1]} alone: {fault}"


def _why_not_reached(endpoints: Sequence[str], context: ssl.SSLContext | None) -> str:
    first = endpoints[0]
    if first.startswith(_LOCAL):
        return f"waiting for a pipeline: {_why_none_runs(first, endpoints)}"
    try:
        host, port = address_of(first)
    except ValueError:
        return f"waiting for {first}"
    secure = first.startswith("tls/")
    why = why_unreachable(host, port, context if secure else None)
    if why is None and secure and ":" in host:
        why = "zenoh cannot connect to an IPv6 address by TLS: give the gateway's name instead"
    return f"waiting for a gateway at {first}: {why or 'it does not answer as one'}"


def _why_none_runs(first: str, endpoints: Sequence[str]) -> str:
    socket_of = Path(first.removeprefix(_LOCAL))
    port = int(socket_of.name) if socket_of.name.isdigit() else 0
    for base_port in (port, port - 1):  # the port is the camera's, or the tracker's
        if (why := why_only_noted(base_port, socket_of.parent)) is not None:
            return why
    camera = socket_of.with_name(str(port - 1))  # the camera's port is `bus.base_port`, which users know
    known = camera if f"{_LOCAL}{camera}" in endpoints else socket_of
    return f"none runs at {known}; `huepose up` starts one"


def why_unreachable(host: str, port: int, context: ssl.SSLContext | None) -> str | None:
    """Why a gateway cannot be reached, in words; None if no reason is found. context: the reader's; None
    without TLS."""
    try:
        link = socket.create_connection((host, port), timeout=_WITHIN_S)
    except (socket.gaierror, UnicodeError):  # UnicodeError: a label of it is empty or too long
        return "no computer of this name is known"
    except ConnectionRefusedError:
        return "no program listens there"
    except TimeoutError:
        return "nothing answers there"
    except OSError as error:
        return error.strerror or str(error)
    with link:
        if context is None:
            return _speaks_tls(link)
        try:
            return _refusal(link, host, context)
        except ssl.SSLCertVerificationError as error:
            if error.verify_code not in _OTHER_HOST:
                return f"its certificate is not accepted: {why_not_accepted(error)}"
    return _for_other_names(host, port, context)


def _speaks_tls(link: socket.socket) -> str | None:
    anyone = ssl.create_default_context()
    anyone.check_hostname, anyone.verify_mode = False, ssl.CERT_NONE
    try:
        anyone.wrap_socket(link).close()
    except OSError:
        return None
    return "it speaks TLS: give authority, certificate and key (in a shell: --tls AUTHORITY CERTIFICATE KEY)"


def _is_kept(secured: ssl.SSLSocket) -> bool:
    """Whether the other side keeps the link open. Raises TimeoutError if it does and sends nothing, as a
    gateway does before it is sent something."""
    try:
        return bool(secured.recv(1))
    except ConnectionError:
        return False


_UNKNOWN_AUTHORITY = (7, 18, 19, 20)
"""X509_V_ERR_CERT_SIGNATURE_FAILURE and the codes for a certificate of an unknown authority (OpenSSL,
x509_vfy.h)."""


_OTHER_HOST = (62, 64)
"""X509_V_ERR_HOSTNAME_MISMATCH and X509_V_ERR_IP_ADDRESS_MISMATCH."""


def why_not_accepted(error: ssl.SSLCertVerificationError) -> str:
    """What is wrong with a certificate, in words."""
    return "another authority signed it" if error.verify_code in _UNKNOWN_AUTHORITY else error.verify_message


def _refusal(link: socket.socket, host: str, context: ssl.SSLContext) -> str | None:
    """Why the other side ends the link; None if it does not. Raises SSLCertVerificationError if it is the
    other side's certificate that is not accepted."""
    try:
        with context.wrap_socket(link, server_hostname=host) as secured:
            # With TLS 1.3 our certificate is refused after the handshake; if it is accepted, nothing is sent.
            secured.settimeout(_REFUSED_WITHIN_S)
            with suppress(TimeoutError):
                if not _is_kept(secured):
                    return "it does not accept this certificate, or has too many readers: its log says why"
    except ssl.SSLCertVerificationError:
        raise
    except ssl.SSLError as error:
        said = str(error.reason or error).replace("_", " ").lower()
        return f"it does not accept this certificate: {said}" if "alert" in said else _without_tls(said)
    except TimeoutError:
        return _without_tls("no answer")
    except OSError as error:
        return _without_tls(error.strerror or str(error))
    return None


def _for_other_names(host: str, port: int, context: ssl.SSLContext) -> str:
    """What to do about a certificate without the name by which its computer was reached."""
    names = ", ".join(_names_at(host, port, context)) or "other names"
    return (
        f"its certificate is for {names}, not for {host}: use such a name, or run `huepose secure host "
        f"{host}` on the gateway's computer"
    )


def _names_at(host: str, port: int, context: ssl.SSLContext) -> list[str]:
    """The names and addresses in the certificate of a gateway, which our authority signed; none if the
    certificate does not come."""
    context.check_hostname = False
    try:
        with socket.create_connection((host, port), _WITHIN_S) as link, context.wrap_socket(link) as secured:
            shown: dict[str, Any] = dict(secured.getpeercert() or {})
    except OSError:
        return []
    finally:
        context.check_hostname = True
    return [name for _, name in shown.get("subjectAltName", ())]


def _without_tls(said: str) -> str:
    return (
        f"it does not answer by TLS ({said}): if it has none, read it without authority, certificate and key "
        "(in a shell: without --tls)"
    )


def fault_of(authority: Path | str, certificate: Path | str, key: Path | str) -> str | None:
    """Why a gateway with this authority would not accept a certificate, by this computer's clock; None if it
    would. (A gateway itself only ends the link.) Raises OSError for files that are no PEM, or do not fit."""
    ours = ssl.create_default_context(cafile=authority)
    ours.check_hostname, ours.verify_mode = False, ssl.CERT_NONE
    theirs = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=authority)
    theirs.verify_mode = ssl.CERT_REQUIRED
    for end in (ours, theirs):  # the gateway's own certificate may be any
        end.load_cert_chain(certificate, key)
    forth, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = ours.wrap_bio(back, forth), theirs.wrap_bio(forth, back, server_side=True)
    try:
        for one in ends * _ROUNDS:
            with suppress(ssl.SSLWantReadError):
                one.do_handshake()
    except ssl.SSLCertVerificationError as error:
        return why_not_accepted(error)
    return None
