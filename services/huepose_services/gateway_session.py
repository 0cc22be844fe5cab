"""The gateway's outer session: what readers can read, and the access rules of zenoh for them.

It has no link to the pipeline's own sessions, so nothing that comes from outside can reach a worker,
whatever its key. In addition there are access rules: a reader may subscribe to keys under `remote/` and
query them, and may publish nothing. The session listens on a socket in the pipeline's folder; the door
passes admitted readers on to it.
"""

from __future__ import annotations

from collections.abc import Callable

import zenoh

from huepose.support.errors import InputError
from huepose_protos.client import peer
from huepose_services.gateway_door import HANDSHAKE_S, RATE_BYTES_S, Door
from huepose_services.runtime.config import GatewayConfig
from huepose_services.runtime.run_folder import make_folder

# Broader than one site, so that readers may use `*` for site and camera: zenoh silently ignores subscriptions
# that are broader than the rule. This session has keys of one camera only.
READABLE = "huepose/*/*/remote/**"
_MAX_MESSAGE = 64 * 1024


def open_outside(
    gateway: GatewayConfig, tell: Callable[[str, str], None]
) -> tuple[zenoh.Session, Door, str | None]:
    """The session, its door, and a warning for health (or None). tell: called with a kind and the reason
    when a reader is refused.

    Raises InputError for files or a port that cannot be used."""
    session, door = open_behind_door(gateway, tell, outside_settings(gateway))
    host = gateway.listen.rsplit(":", 1)[0]
    if gateway.tls is None and not (host in ("localhost", "[::1]") or host.startswith("127.")):
        return session, door, f"anyone who reaches {gateway.listen} can read poses: gateway.tls is not set"
    return session, door, None


def open_behind_door(
    gateway: GatewayConfig,
    tell: Callable[[str, str], None],
    settings: dict[str, object],
    rate_bytes_s: float = RATE_BYTES_S,
    section: str = "gateway",
) -> tuple[zenoh.Session, Door]:
    """A session with these settings, reached through its door alone; what a reader may say; which section of
    pipeline.yaml it is.

    Raises InputError for files or a port that cannot be used."""
    inside = make_folder() / f"outside-{gateway.listen.rsplit(':', 1)[1]}"
    config = peer([], [f"unixsock-stream/{inside}"], settings)
    door = Door(gateway, inside, tell, rate_bytes_s, section)
    try:
        return zenoh.open(config), door
    except zenoh.ZError as error:
        door.close()
        raise InputError(
            f"socket {inside}",
            found=" ".join(str(error).split())[:300],
            expected="that no other gateway of this user is there",
            fix=f"Stop the other pipeline, or set {section}.listen.",
        ) from None


def outside_settings(gateway: GatewayConfig) -> dict[str, object]:
    """The settings of this session, in addition to those of every session."""
    return {
        "transport/link/rx/max_message_size": _MAX_MESSAGE,
        "transport/unicast/max_sessions": gateway.max_sessions,
        # The door counts sessions. One that sends nothing counts for its reader, too, and is closed after
        # this.
        "transport/unicast/accept_pending": gateway.max_sessions,
        "transport/unicast/accept_timeout": int(1000.0 * HANDSHAKE_S),
        "access_control": allowed(
            ("ask", "ingress", READABLE, "declare_subscriber", "query"),
            ("hear", "egress", READABLE, "put", "delete", "reply", "declare_queryable"),
        ),
    }


def allowed(*rules: tuple[str, ...]) -> dict[str, object]:
    """zenoh's access control: only these rules are allowed. rules: name, flow, key and messages."""
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {"id": name, "permission": "allow", "flows": [flow], "key_exprs": [key], "messages": messages}
            for name, flow, key, *messages in rules
        ],
        "subjects": [{"id": "reader"}],
        "policies": [{"rules": [rule[0] for rule in rules], "subjects": ["reader"]}],
    }
