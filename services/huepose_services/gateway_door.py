"""Admission to the gateway: check each new connection, and limit how much one reader may use.

Only the door listens on an address that other machines can reach. It identifies a reader by the common name
of its certificate; without TLS, by its address. It passes the bytes of an admitted reader on to the
gateway's outer session, through a socket in the pipeline's own folder, and the answers back.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from errno import EADDRNOTAVAIL
from pathlib import Path

from msgspec.structs import replace

from huepose.support.errors import InputError
from huepose_protos.reach import why_not_accepted
from huepose_services.pem import check_pem, tls_context
from huepose_services.runtime.config import GatewayConfig
from huepose_services.runtime.config_perception import TLS_FILES

HANDSHAKE_S = 3.0
"""The most time that a connection may take for the TLS handshake, and then until it has opened its
session."""
PENDING, PENDING_OF_ONE = 32, 8
"""The most connections that are not identified yet: in total, and from one address."""
RATE_BYTES_S, BURST_BYTES = 16 * 1024, 64 * 1024
"""What a reader may send, on all its sessions together: it needs only queries and keep-alive messages."""
_CHUNK = 16 * 1024
_LOOK_EVERY_S = 0.5
_SECONDS_A_DAY = 86_400.0
_FREEBIND = {socket.AF_INET: (socket.IPPROTO_IP, 15), socket.AF_INET6: (socket.IPPROTO_IPV6, 78)}
"""IP_FREEBIND and IPV6_FREEBIND of Linux (linux/in.h, linux/in6.h), which Python does not name: they allow
to listen on an address that no network interface has yet."""


@dataclass
class _Reader:
    """What one reader uses: its sessions and its allowance of bytes."""

    rate_bytes_s: float = RATE_BYTES_S
    sessions: int = 0
    allowance: float = BURST_BYTES
    at: float = field(default_factory=time.monotonic)

    def wait_s(self, sent_bytes: int) -> float:
        """Count the bytes that the reader sent. Returns how long to wait before more is read from it."""
        now = time.monotonic()
        self.allowance = min(BURST_BYTES, self.allowance + (now - self.at) * self.rate_bytes_s) - sent_bytes
        self.at = now
        return max(0.0, -self.allowance / self.rate_bytes_s)


class Door:
    """Listens from its construction until `close`. `refused`: how many connections were refused. tell:
    called with a word for the kind of an event, and a sentence; rate_bytes_s: what a reader may send;
    section: of pipeline.yaml, for errors.

    Raises InputError for a port that is taken, or certificates that do not fit."""

    def __init__(
        self,
        gateway: GatewayConfig,
        inside: Path,
        tell: Callable[[str, str], None],
        rate_bytes_s: float,
        section: str,
    ) -> None:
        self._gateway, self._inside, self._tell = gateway, inside, tell
        self._rate_bytes_s, self._section = rate_bytes_s, section
        self.refused = 0
        self._tls = _context(gateway, section)
        self._listener = self._listen()
        self._readers: dict[str, _Reader] = {}
        self._pending: Counter[str] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="door", daemon=True)
        self._thread.start()

    def _listen(self) -> socket.socket:
        """Listen, also if no network interface has the address yet: then readers can connect once one has
        it."""
        try:
            return _listener(self._gateway, self._section)
        except InputError as error:
            if not isinstance(error.__context__, OSError) or error.__context__.errno != EADDRNOTAVAIL:
                raise
            listener = _listener(self._gateway, self._section, early=True)
        listen = f"{self._section}.listen {self._gateway.listen}"
        self._tell("address", f"{listen}: no network here has that address yet, so nobody can connect")
        return listener

    def reload(self, gateway: GatewayConfig) -> None:
        """Take over new limits. If the list of readers changed, all must connect again."""
        before = self._gateway
        tls = before.tls and gateway.tls and replace(before.tls, readers=gateway.tls.readers)
        sessions = gateway.sessions_per_reader
        self._gateway = replace(before, sessions_per_reader=sessions, tls=tls or before.tls)
        if before.tls != self._gateway.tls:
            self._loop.call_soon_threadsafe(self._disconnect_all)

    def _disconnect_all(self) -> None:
        for task in self._tasks:
            task.cancel()

    def close(self) -> None:
        """Stop listening, and close all connections."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        always = [self._loop.create_task(self._accept()), self._loop.create_task(self._watch())]
        self._loop.run_forever()
        tasks = [*always, *self._tasks]
        for task in tasks:
            task.cancel()
        self._loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
        self._listener.close()
        self._loop.close()

    async def _accept(self) -> None:
        while True:
            try:
                link, address = await self._loop.sock_accept(self._listener)
            except OSError:
                await asyncio.sleep(0.1)  # too many open files: wait until some are closed
                continue
            host = str(address[0])
            if self._pending.total() >= PENDING or self._pending[host] >= PENDING_OF_ONE:
                link.close()
                self._refuse("too often", f"{host} connects too often")
                continue
            self._pending[host] += 1
            task = self._loop.create_task(self._serve(link, host))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _watch(self) -> None:
        """When the TLS files change, read them again and close all connections: readers must connect
        again."""
        before = _changed(self._gateway)
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            if (now := _changed(self._gateway)) == before:
                continue
            before = now
            try:
                self._tls = _context(self._gateway, self._section)
            except InputError as error:
                self._tell(
                    "certificates", f"its certificates have changed, and the old ones stay in use: {error}"
                )
                continue
            self._disconnect_all()

    async def _serve(self, link: socket.socket, host: str) -> None:
        writer = None
        try:
            try:
                reader, writer = await self._greet(link)
                name, until_s = self._known(writer, host)
            except (OSError, asyncio.TimeoutError) as error:
                why = _in_words(error)
                self._refuse(why, f"{host}: {why}")
                return
            finally:
                self._pending[host] -= 1
                self._pending += Counter()  # forgets those at zero
            if (refusal := self._why_not(name)) is not None:
                self._refuse(*refusal)
                return
            self._readers.setdefault(name, _Reader(self._rate_bytes_s)).sessions += 1
            try:
                await asyncio.wait_for(self._pass_on(name, reader, writer), until_s)
            finally:
                self._readers[name].sessions -= 1
        except (OSError, asyncio.TimeoutError):
            pass  # it has disconnected, or its certificate has expired
        finally:
            if writer is not None:
                writer.transport.abort()
            link.close()

    async def _greet(self, link: socket.socket) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        reader = asyncio.StreamReader(_CHUNK, self._loop)
        protocol = asyncio.StreamReaderProtocol(reader, loop=self._loop)
        timeout_s = None if self._tls is None else HANDSHAKE_S
        transport, _ = await self._loop.connect_accepted_socket(
            lambda: protocol, link, ssl=self._tls, ssl_handshake_timeout=timeout_s
        )
        return reader, asyncio.StreamWriter(transport, protocol, reader, self._loop)

    def _known(self, writer: asyncio.StreamWriter, host: str) -> tuple[str, float | None]:
        """The name of the reader, and for how many seconds its certificate is valid (None without TLS)."""
        certificate = writer.get_extra_info("peercert")
        if self._tls is None:
            return host, None
        names = [value for part in certificate["subject"] for key, value in part if key == "commonName"]
        left_s = ssl.cert_time_to_seconds(certificate["notAfter"]) - time.time()
        # A timer cannot wait for years: at most 24 days.
        return (names or ["(no name)"])[0], min(left_s, 24.0 * _SECONDS_A_DAY)

    def _why_not(self, name: str) -> tuple[str, str] | None:
        """Why a reader is refused, as kind and sentence; None if it is admitted."""
        gateway, reader = self._gateway, self._readers.get(name)
        if gateway.tls is not None and gateway.tls.readers and name not in gateway.tls.readers:
            return f"not {name}", f"{name} is not one of gateway.tls.readers"
        if reader is not None and reader.sessions >= gateway.sessions_per_reader:
            return "sessions", f"{name} has {reader.sessions} sessions (gateway.sessions_per_reader)"
        if sum(reader.sessions for reader in self._readers.values()) >= gateway.max_sessions:
            every = f"there are {gateway.max_sessions} sessions (gateway.max_sessions)"
            return "full", f"no session is left for {name}: {every}"
        return None

    def _refuse(self, kind: str, why: str) -> None:
        self.refused += 1
        self._tell(f"refused: {kind}", f"a reader is refused: {why}")

    async def _pass_on(self, name: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        back, forth = await asyncio.open_unix_connection(str(self._inside), limit=_CHUNK)
        pumps = [
            self._loop.create_task(_pump(reader, forth, self._readers[name])),
            self._loop.create_task(_pump(back, writer, None)),
        ]
        try:
            await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for pump in pumps:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)
            forth.transport.abort()


def _in_words(error: Exception) -> str:
    """Why a connection could not be identified."""
    reason = str(getattr(error, "reason", None) or "")
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not accepted: {why_not_accepted(error)}"
    if reason in ("WRONG_VERSION_NUMBER", "HTTP_REQUEST"):
        return "it speaks without TLS"
    if reason == "PEER_DID_NOT_RETURN_A_CERTIFICATE":
        return "it shows no certificate"
    if "_ALERT_" in reason:
        alert = reason.partition("_ALERT_")[2].replace("_", " ").lower()
        return f"it does not accept the certificate of this side, or not for this name or address ({alert})"
    return " ".join(str(error).split())[:200] or "it sent nothing"


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter, limit: _Reader | None) -> None:
    """Copy bytes from source to sink, no faster than the sink takes them and the limit allows."""
    with suppress(OSError):
        while data := await source.read(_CHUNK):
            sink.write(data)
            await sink.drain()
            if limit is not None and (wait_s := limit.wait_s(len(data))) > 0.0:
                await asyncio.sleep(wait_s)


def _context(gateway: GatewayConfig, section: str) -> ssl.SSLContext | None:
    tls = gateway.tls
    if tls is None:
        return None
    for name in TLS_FILES:
        if (path := getattr(tls, name)) is not None:
            check_pem(f"{section}.tls.", name, Path(path))
    what = f"the certificates of {section}"
    context = tls_context(ssl.Purpose.CLIENT_AUTH, what, tls.authority, tls.certificate, tls.key, tls.revoked)
    context.verify_mode = ssl.CERT_REQUIRED
    return context


def _changed(gateway: GatewayConfig) -> list[tuple[int, int]]:
    """The modification times and inodes of the TLS files: they differ after a change."""
    out = []
    for name in TLS_FILES:
        path = None if gateway.tls is None else getattr(gateway.tls, name)
        with suppress(OSError):
            if path is not None:
                status = Path(path).stat()
                out.append((status.st_mtime_ns, status.st_ino))
    return out


def check_door(gateway: GatewayConfig, section: str = "gateway") -> None:
    """Raises InputError for files or an address with which no Door can be made; leaves nothing open."""
    _context(gateway, section)
    _listener(gateway, section, port=0).close()


def check_free(gateway: GatewayConfig, section: str = "gateway") -> None:
    """Raises InputError if a Door could not listen now; leaves nothing open."""
    _listener(gateway, section).close()


def _listener(
    gateway: GatewayConfig, section: str, port: int | None = None, early: bool = False
) -> socket.socket:
    """A socket that listens. port: instead of the configured one, 0 for any; early: also on an address that
    no network interface has yet."""
    written, own = gateway.listen.rsplit(":", 1)
    host, family = written.strip("[]"), socket.AF_INET6 if written.startswith("[") else socket.AF_INET
    try:
        listener = _bound(family, host, int(own) if port is None else port, early)
    except OSError as error:
        raise InputError(
            f"{section}.listen {gateway.listen}",
            found=error.strerror or str(error),
            expected="an address of this computer and a free port",
            fix=f"Set {section}.listen, or end the other program.",
        ) from None
    listener.setblocking(False)
    return listener


def _bound(family: socket.AddressFamily, host: str, port: int, early: bool) -> socket.socket:
    """A socket that listens on host and port. Raises OSError."""
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, host != "::")
        if early:
            listener.setsockopt(*_FREEBIND[family], 1)
        listener.bind((host, port))
        listener.listen(PENDING)
    except OSError:
        listener.close()
        raise
    return listener
