"""The gateway's outer session: the one listener that other machines reach, and all that zenoh forbids on it.

It has no link to the pipeline's own sessions, so nothing that comes from outside can reach a worker, whatever
its key. The access rules come on top: a reader may subscribe to and ask for keys under `remote/`, and may put
nothing. With TLS it must show a certificate of the configured authority, with a listed name where there are
any.
"""

from __future__ import annotations

import json
from pathlib import Path

import zenoh

from huepose.support.errors import InputError
from huepose_services.pem import check_pem
from huepose_services.runtime.config import GatewayConfig, TlsConfig

# Broader than one site, so that readers may use `*` for site and camera: zenoh silently ignores subscriptions
# that are broader than the rule. This session has keys of one camera only.
READABLE = "huepose/*/*/remote/**"
_MAX_MESSAGE = 64 * 1024


def open_outside(gateway: GatewayConfig) -> tuple[zenoh.Session, list[str]]:
    """The session, and warnings for health. Raises InputError for files or a port that cannot be used."""
    if gateway.tls is not None:
        _check_files(gateway.tls)
    config = zenoh.Config()
    for name, value in outside_settings(gateway).items():
        config.insert_json5(name, json.dumps(value))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise InputError(
            f"gateway.listen {gateway.listen}",
            found="another program there" if "in use" in str(error) else " ".join(str(error).split())[:300],
            expected="a free port, and certificate and key in PEM that belong together",
            fix="Set gateway.listen, or make the certificate again.",
        ) from None
    host = gateway.listen.rsplit(":", 1)[0]
    if gateway.tls is None and not (host == "localhost" or host.startswith("127.")):
        return session, [f"anyone who reaches {gateway.listen} can read poses: gateway.tls is not set"]
    return session, []


def outside_settings(gateway: GatewayConfig) -> dict[str, object]:
    """What differs from zenoh's defaults."""
    settings: dict[str, object] = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "connect/endpoints": [],
        "listen/endpoints": [f"{'tcp' if gateway.tls is None else 'tls'}/{gateway.listen}"],
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": _MAX_MESSAGE,
        "transport/unicast/max_sessions": gateway.max_sessions,
        "transport/unicast/accept_pending": 8,
        "access_control": _access(gateway.tls),
    }
    if gateway.tls is not None:
        settings["transport/link/tls"] = {
            "root_ca_certificate": gateway.tls.authority,
            "listen_certificate": gateway.tls.certificate,
            "listen_private_key": gateway.tls.key,
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
    return settings


def _access(tls: TlsConfig | None) -> dict[str, object]:
    reader: dict[str, object] = {"id": "reader"}
    if tls is not None:
        reader["link_protocols"] = ["tls"]
        if tls.readers:
            reader["cert_common_names"] = list(tls.readers)
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
        "subjects": [reader],
        "policies": [{"rules": ["ask", "hear"], "subjects": ["reader"]}],
    }


def _check_files(tls: TlsConfig) -> None:
    for name in ("authority", "certificate", "key"):
        check_pem(f"gateway.tls.{name}", Path(getattr(tls, name)))
