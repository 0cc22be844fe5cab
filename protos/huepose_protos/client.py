"""A light client: it reads the messages of any machine, with nothing but zenoh, msgspec and numpy.

>>> with Reader(pose_endpoints(), "huepose/*/*/pose/**") as reader:    # doctest: +SKIP
...     while (message := reader.next(1.0)) is not None:
...         print(message.object, message.state, message.translation)
"""

from __future__ import annotations

import atexit
import json
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import zenoh

from huepose_protos.codec import decode
from huepose_protos.fields import WireError
from huepose_protos.keys import tail_of
from huepose_protos.messages import (
    CameraMessage,
    CorrectionMessage,
    Estimates,
    HealthMessage,
    HypothesesMessage,
    IntakeMessage,
    MemoryMessage,
    Message,
    ObjectsMessage,
    PerceptionRequest,
    PoseMessage,
    TruthMessage,
)
from huepose_protos.reach import endpoint_of

Hear = Callable[[zenoh.Sample], None]

_ASK_TIMEOUT_S = 2.0
_OPEN_WITHIN_MS = 2_000
"""For a new link of a session that only reads. If the other side does not answer, because it hangs or has no
TLS, closing the session takes this long; zenoh's default is ten seconds."""
_ROOM = 65_536  # samples that may wait for a busy program before the bus does
_WAITING = 16_384
"""Messages that a Reader keeps for a busy program: two minutes of five objects at 30 Hz, some 20 MB."""
_KINDS: dict[str, type[Message]] = {
    "pose": PoseMessage,
    "health": HealthMessage,
    "camera": CameraMessage,
    "objects": ObjectsMessage,
    "truth": TruthMessage,
    "correction": CorrectionMessage,
    "perception/request": PerceptionRequest,
    "perception/estimates": Estimates,
    "tracker/hypotheses": HypothesesMessage,
    "tracker/intake": IntakeMessage,
    "tracker/memory": MemoryMessage,
}


def kind_of(key: str) -> type[Message] | None:
    """The type of the messages under a key; None for keys with pixels and unknown ones."""
    tail = tail_of(key)
    return next((kind for head, kind in _KINDS.items() if tail == head or tail.startswith(head + "/")), None)


def configured(settings: Mapping[str, object]) -> zenoh.Config:
    """zenoh's configuration with these settings."""
    config = zenoh.Config()
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return config


def peer(
    connect: Sequence[str], listen: Sequence[str] = (), more: Mapping[str, object] | None = None
) -> zenoh.Config:
    """A configuration for a session that listens and connects at these endpoints only, without discovery. It
    keeps trying to connect, at first and after a link was lost. more: further settings."""
    settings: dict[str, object] = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 50, "period_max_ms": 400, "period_increase_factor": 1.5},
        # Do not wait half a second for peers that may not be there yet.
        "open/return_conditions/connect_scouted": False,
        "transport/shared_memory/enabled": False,
    }
    if not listen:
        settings["transport/unicast/open_timeout"] = _OPEN_WITHIN_MS
    return configured({**settings, **(more or {})})


def tls_files(
    authority: Path | str | None, certificate: Path | str | None, key: Path | str | None
) -> dict[str, object]:
    """The settings to connect by TLS, with files in PEM."""
    files = {"root_ca_certificate": authority, "connect_certificate": certificate, "connect_private_key": key}
    settings: dict[str, object] = {"transport/link/tls/enable_mtls": certificate is not None}
    for name, path in files.items():
        if path is not None:
            if not Path(path).is_file():
                raise FileNotFoundError(f"{name}: no file {path}")
            settings[f"transport/link/tls/{name}"] = str(path)
    return settings


def open_session(
    endpoints: Sequence[str],
    authority: Path | str | None = None,
    certificate: Path | str | None = None,
    key: Path | str | None = None,
) -> zenoh.Session:
    """A session that listens nowhere and keeps trying to connect to its endpoints, at first and after a link
    was lost.

    endpoints: as `reach.endpoint_of` takes them. The files, in PEM, are for endpoints with TLS
    (`tls/HOST:PORT`): the authority that signed the other side's certificate, and the reader's own
    certificate and key. Raises ValueError for endpoints and files that zenoh cannot use."""
    addresses = [endpoint_of(one, tls=authority is not None) for one in endpoints]
    try:
        return zenoh.open(peer(addresses, more=tls_files(authority, certificate, key)))
    except zenoh.ZError as error:
        why = re.sub(r" at \S+\.rs:\d+\.?", "", " ".join(str(error).split()))[:200]
        raise ValueError(f"{', '.join(addresses)} cannot be used: {why}") from None


C = TypeVar("C", bound="Client")


class Client:
    """A session that listens until it is closed, at the latest when the program ends.

    Its threads are daemons. (With a callback, zenoh makes a thread that keeps a program alive for ever if its
    session is left open, for example after Ctrl-C.) `refused`: how many messages could not be decoded."""

    def __init__(self, session: zenoh.Session) -> None:
        self.refused = 0
        self._threads: list[threading.Thread] = []
        self._session = session
        atexit.register(self.close)

    def _listen(
        self, declare: Callable[..., Iterable[zenoh.Sample]], key: str, hear: Hear, **more: bool
    ) -> None:
        """Call `hear` with each sample on a key. declare: a session's `declare_subscriber`; more: its further
        arguments."""
        subscriber = declare(key, zenoh.handlers.FifoChannel(_ROOM), **more)

        def move() -> None:
            for sample in subscriber:
                hear(sample)

        thread = threading.Thread(target=move, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _decoded(self, key: str, data: bytes) -> Message | None:
        """The message of a key; None for bytes that are none, which are counted, and for an unknown key."""
        kind = kind_of(key)
        try:
            return None if kind is None else decode(data, kind)
        except WireError:
            self.refused += 1
            return None

    @property
    def connected(self) -> bool:
        """Whether there is a link to any endpoint now."""
        return bool(self._session.info.peers_zid())

    def close(self) -> None:
        """Disconnect from the bus."""
        atexit.unregister(self.close)
        self._session.close()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    def __enter__(self: C) -> C:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


_ALL_LIVE = "huepose/*/*/live/*"


def _live_beside(key: str) -> str:
    """The expression for the workers of the pipelines that a key is of.

    >>> _live_beside("huepose/lab/cam0/pose/**"), _live_beside("huepose/**")
    ('huepose/lab/cam0/live/*', 'huepose/*/*/live/*')
    """
    names = key.split("/")[1:3]
    return _ALL_LIVE if len(names) < 2 or "**" in names else f"huepose/{'/'.join(names)}/live/*"


class Reader(Client):
    """Messages on key expressions from workers, or a gateway, at the given endpoints, as soon as these can
    be reached. The files are those of `open_session`.

    Only workers of the pipelines that the keys name count, not those of another one at ports beside.
    `seen`: whether a worker was there since the start; `live`: keys of the workers that are there now;
    `gone_since`: when the last of them ended (time.monotonic), None while one is there. A gateway shows
    none of this. `missed`: messages that were dropped, the oldest first, because `next` was not called for
    too long."""

    def __init__(
        self,
        endpoints: Sequence[str],
        *keys: str,
        authority: Path | str | None = None,
        certificate: Path | str | None = None,
        key: Path | str | None = None,
    ) -> None:
        self.seen = False
        self.live: set[str] = set()
        self.gone_since: float | None = None
        self.missed = 0
        self._messages: deque[tuple[str, bytes]] = deque(maxlen=_WAITING)
        self._came = threading.Condition()
        self._closed = False
        self._keys, self._heard = keys, set[str]()
        super().__init__(open_session(endpoints, authority, certificate, key))
        tokens = self._session.liveliness().declare_subscriber
        for expression in {_live_beside(key) for key in keys} or {_ALL_LIVE}:
            self._listen(tokens, expression, self._on_token, history=True)
        for expression in keys:
            self._listen(self._session.declare_subscriber, expression, self._on_sample)

    def _on_token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self.live.add(str(sample.key_expr))
            self.seen, self.gone_since = True, None
        else:
            self.live.discard(str(sample.key_expr))
            self.gone_since = None if self.live else time.monotonic()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        if sample.attachment is None:  # messages with pixels have their header there
            self._heard.add(str(sample.key_expr))
            with self._came:
                self.missed += len(self._messages) == _WAITING
                self._messages.append((str(sample.key_expr), sample.payload.to_bytes()))
                self._came.notify()

    def ask(self) -> None:
        """Ask a gateway for the latest message of every key; the answer is left out if a message comes by
        itself before it."""
        self._heard.clear()
        for expression in self._keys:
            self._session.get(expression, self._on_reply, timeout=_ASK_TIMEOUT_S)

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None and str(reply.ok.key_expr) not in self._heard:
            self._on_sample(reply.ok)

    @property
    def pending(self) -> int:
        """How many messages wait to be read."""
        return len(self._messages)

    def next(self, timeout_s: float | None = None) -> Message | None:
        """The next message that can be decoded; None after the timeout, or when the reader is closed."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            with self._came:
                left_s = None if until is None else until - time.monotonic()
                self._came.wait_for(lambda: self._messages or self._closed, left_s)
                if not self._messages:
                    return None
                key, data = self._messages.popleft()
            if (message := self._decoded(key, data)) is not None:
                return message

    def close(self) -> None:
        """Disconnect; whoever waits for a message gets None."""
        with self._came:
            self._closed = True
            self._came.notify_all()
        super().close()
