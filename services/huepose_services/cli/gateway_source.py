"""The gateway of another machine: which one the options name, and its messages."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from huepose.support.errors import InputError
from huepose_services.cli.options import LOOK_EVERY_S, SAY_WAITING_AFTER_S, say
from huepose_services.pem import Credentials

if TYPE_CHECKING:
    from huepose_protos.messages import Message


@dataclass(frozen=True)
class Gateway:
    """A gateway. endpoint: its address in the format of zenoh; credentials: None without TLS."""

    endpoint: str
    credentials: Credentials | None

    def messages(self, tail: str, stopping: Callable[[], bool], *more: str) -> Iterator[Message]:
        """The messages of a key, and of the list of objects (`more`), until stopped. First come the latest
        ones. If none of the key arrive, the cause is printed to stderr."""
        from huepose_protos.client import Reader
        from huepose_protos.messages import ObjectsMessage

        files = {} if self.credentials is None else self.credentials._asdict()
        keys = [f"huepose/*/*/remote/{each}" for each in (tail, *more)]
        with Reader([self.endpoint], *keys, **files) as reader:
            connected, since, look = False, time.monotonic(), 0.0
            while not stopping():
                now = time.monotonic()
                if now >= look:
                    look, before, connected = now + LOOK_EVERY_S, connected, reader.connected
                    if connected and not before:
                        reader.ask()
                    if connected != before:
                        since = now
                    if before and not connected:
                        say(f"the gateway at {self.endpoint} is gone; waiting for it")
                message = reader.next(LOOK_EVERY_S)
                if message is not None:
                    if not (more and isinstance(message, ObjectsMessage)):
                        since = float("inf")  # until the link is lost
                    yield message
                elif now - since > SAY_WAITING_AFTER_S:
                    since = float("inf")
                    say(self._silence(connected, tail))

    def _silence(self, connected: bool, tail: str) -> str:
        from huepose_protos.reach import why_unreached

        if connected:
            why = "no object is seen" if tail.startswith("pose/") else "a gateway does not show all keys"
            return (
                f"connected to {self.endpoint}, but nothing is published on {tail}: {why}, or a worker is "
                "missing there; `huepose status` there says which"
            )
        if self.credentials is None:
            return why_unreached([self.endpoint], None)
        return why_unreached([self.endpoint], self.credentials.context(), self.credentials)


def gateway_of(arguments: argparse.Namespace) -> Gateway | None:
    """The gateway that the options name; None for a pipeline on this machine. Raises InputError."""
    from huepose_protos.reach import address_of, endpoint_of

    if arguments.gateway is None:
        if arguments.tls is not None:
            raise InputError("--tls", found="no --gateway", expected="the gateway that it is for")
        return None
    if arguments.pipeline is not None or arguments.config is not None:
        raise InputError("--gateway", found="--pipeline or --config beside it", expected="one of the three")
    try:
        address_of(arguments.gateway)
        host_port = arguments.gateway.removeprefix("tcp/").removeprefix("tls/")
        endpoint = endpoint_of(host_port, tls=arguments.tls is not None)
    except ValueError:
        raise InputError("--gateway", found=arguments.gateway, expected="HOST or HOST:PORT") from None
    credentials = None if arguments.tls is None else Credentials(*arguments.tls)
    if credentials is not None:
        credentials.context()  # reports wrong files before any waiting
    return Gateway(endpoint, credentials)
