"""The link between the two computers of a pipeline: a session on each side, and what these allow.

Pixels and the list of objects go up from the camera's computer; answers and health come down. Neither
session has a link to the workers. The session of the camera's computer is behind a door, which admits only
the other computer's certificate; with it one may publish under `down/` and subscribe under `up/`.
Timestamps of frames stay those of the camera's clock, so the two clocks need not agree.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from pathlib import Path

import zenoh

from huepose.support.errors import InputError
from huepose_protos.client import tls_files
from huepose_protos.messages import Detections, Estimates, FrameHeader, Look, Masks
from huepose_services.gateway_door import Door, check_door, check_free
from huepose_services.gateway_session import allowed, open_behind_door, outside_settings
from huepose_services.pem import Credentials
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import Config, GatewayConfig, TlsConfig
from huepose_services.runtime.session import MIB, zenoh_config

SILENT_NS = 5 * SECOND // 2
"""Health comes once a second: a worker without health for this long counts as gone."""
_LEASE_MS = 3000
"""After this time without a message from the other side the connection is closed and made again."""
_PATIENCE_US = 1_000_000
"""The longest time that a piece of a frame, 64 KiB, waits to be sent; then the frame is dropped."""
_SESSIONS = 4
"""Allowed for the other computer: after a cut cable old sessions stay until their lease has expired."""
_ANSWERS_BYTES_S = 1.0 * MIB
"""What the other computer may send. Its answers are some KiB, a few times a second."""
_ABOVE = 64 * 1024
_COMMON: dict[str, object] = {
    "transport/link/tx/lease": _LEASE_MS,
    "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": _PATIENCE_US,
}


def taken_up(config: Config) -> tuple[str, type[Look] | type[Detections] | type[Masks]]:
    """Key and type of the message that goes up with its pixels: the input of the first worker of the other
    computer."""
    keys = config.keys
    if config.far[0] == "detector":
        return keys.look, Look
    return (keys.detections, Detections) if config.far[0] == "segmenter" else (keys.masks, Masks)


def check_link(config: Config) -> None:
    """Check that the files and the address of this side can be used. Raises InputError."""
    if "uplink" in config.workers:
        check_door(_door(config), "link")
    elif "downlink" in config.workers:
        credentials(config).context()


def check_uplink_free(config: Config) -> None:
    """Raises InputError if another program listens on the uplink's address."""
    check_free(_door(config), "link")


def open_uplink(config: Config, tell: Callable[[str, str], None]) -> tuple[zenoh.Session, Door]:
    """The session of the camera's computer, and its door; tell: called with a kind and the reason when a
    connection is refused.

    Raises InputError for files or a port that cannot be used."""
    door = _door(config)
    up, down = config.keys.of_tail("up/**"), config.keys.of_tail("down/**")
    own: dict[str, object] = {
        "transport/link/rx/max_message_size": Estimates.max_bytes + _ABOVE,
        "transport/unicast/accept_pending": _SESSIONS,
        "access_control": allowed(
            ("ask", "ingress", up, "declare_subscriber"),
            ("hear", "egress", up, "put"),
            ("say", "ingress", down, "put"),
            ("listen", "egress", down, "declare_subscriber"),
        ),
    }
    settings = outside_settings(door) | _COMMON | own
    return open_behind_door(door, tell, settings, _ANSWERS_BYTES_S, "link")


def open_downlink(config: Config) -> zenoh.Session:
    """The session of the other computer: it tries again and again to reach the camera's. Raises
    InputError."""
    files = credentials(config)
    files.context()
    more = _COMMON | tls_files(*files)
    return zenoh.open(zenoh_config([], [f"tls/{config.link.connect}"], more=more))


def credentials(config: Config) -> Credentials:
    """The certificate files of the other computer."""
    folder = Path(config.link.secure)
    return Credentials(
        folder / "authority.pem", folder / f"{config.other_host}.pem", folder / f"{config.other_host}.key"
    )


def _door(config: Config) -> GatewayConfig:
    if config.other_host is None:
        raise InputError("uplink", found="no second computer", expected="one in `hosts`")
    folder = Path(config.link.secure)
    tls = TlsConfig(
        authority=str(folder / "authority.pem"),
        certificate=str(folder / "gateway.pem"),
        key=str(folder / "gateway.key"),
        revoked=str(folder / "revoked.pem"),
        readers=[config.other_host],
    )
    return GatewayConfig(
        listen=config.link.listen, max_sessions=_SESSIONS, sessions_per_reader=_SESSIONS, tls=tls
    )


class Sender:
    """Sends pixels in a thread, so that nobody waits for a slow network: a newer frame replaces one that
    waits."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
        )
        self._ready = threading.Condition()
        self._waiting: tuple[FrameHeader, bytes, bytes] | None = None
        self._open = True
        self.replaced = 0
        self.sent: queue.SimpleQueue[tuple[int, FrameHeader]] = queue.SimpleQueue()
        """When sending began, and the frame, for each frame that was sent."""
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    def offer(self, frame: FrameHeader, header: bytes, payload: bytes) -> None:
        """Send this as soon as possible, unless a newer frame replaces it."""
        with self._ready:
            self.replaced += self._waiting is not None
            self._waiting = (frame, header, payload)
            self._ready.notify()

    def close(self) -> None:
        """Send nothing more."""
        with self._ready:
            self._open = False
            self._ready.notify()
        self._thread.join(0.5)

    def _run(self) -> None:
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._waiting is not None or not self._open)
                if not self._open:
                    return
                assert self._waiting is not None
                (frame, header, payload), self._waiting = self._waiting, None
            started = now_ns()
            self._publisher.put(payload, attachment=header)
            self.sent.put((started, frame))
