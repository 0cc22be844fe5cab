"""The gateway's outer session: what readers get, and all that zenoh forbids them.

It has no link to the pipeline's own sessions, so nothing that comes from outside can reach a worker, whatever
its key. The access rules come on top: a reader may subscribe to and ask for keys under `remote/`, and may put
nothing. It listens on a socket in the pipeline's folder; the door lets those through who may read.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import zenoh

from huepose.support.errors import InputError
from huepose_services.gateway_door import Door
from huepose_services.pem import check_pem
from huepose_services.runtime.config import TLS_FILES, GatewayConfig, TlsConfig
from huepose_services.runtime.run_folder import make_folder

# Broader than one site, so that readers may use `*` for site and camera: zenoh silently ignores subscriptions
# that are broader than the rule. This session has keys of one camera only.
READABLE = "huepose/*/*/remote/**"
_MAX_MESSAGE = 64 * 1024


def open_outside(
    gateway: GatewayConfig, tell: Callable[[str], None]
) -> tuple[zenoh.Session, Door, list[str]]:
    """The session, its door, and warnings for health; tell: called with why a reader is not let in.

    Raises InputError for files or a port that cannot be used."""
    if gateway.tls is not None:
        _check_files(gateway.tls)
    inside = make_folder() / f"outside-{gateway.listen.rsplit(':', 1)[1]}"
    config = zenoh.Config()
    for name, value in outside_settings(gateway, inside).items():
        config.insert_json5(name, json.dumps(value))
    door = Door(gateway, inside, tell)
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        door.close()
        raise InputError(
            f"socket {inside}",
            found=" ".join(str(error).split())[:300],
            expected="that no other gateway of this user is there",
            fix="Stop the other pipeline, or set gateway.listen.",
        ) from None
    host = gateway.listen.rsplit(":", 1)[0]
    if gateway.tls is None and not (host == "localhost" or host.startswith("127.")):
        return session, door, [f"anyone who reaches {gateway.listen} can read poses: gateway.tls is not set"]
    return session, door, []


def outside_settings(gateway: GatewayConfig, inside: Path) -> dict[str, object]:
    """What differs from zenoh's defaults."""
    return {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "connect/endpoints": [],
        "listen/endpoints": [f"unixsock-stream/{inside}"],
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": _MAX_MESSAGE,
        "transport/unicast/max_sessions": gateway.max_sessions,
        "transport/unicast/accept_pending": 8,
        "access_control": _access(),
    }


def _access() -> dict[str, object]:
    rule = {"permission": "allow", "key_exprs": [READABLE]}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            rule | {"id": "ask", "flows": ["ingress"], "messages": ["declare_subscriber", "query"]},
            rule
            | {
                "id": "hear",
                "flows": ["egress"],
                "messages": ["put", "delete", "reply", "declare_queryable"],
            },
        ],
        "subjects": [{"id": "reader"}],
        "policies": [{"rules": ["ask", "hear"], "subjects": ["reader"]}],
    }


def _check_files(tls: TlsConfig) -> None:
    for name in TLS_FILES:
        if (path := getattr(tls, name)) is not None:
            check_pem(f"gateway.tls.{name}", Path(path))
