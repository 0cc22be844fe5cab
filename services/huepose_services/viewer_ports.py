"""Check the ports of the viewer's page; a module of its own, because it must work without rerun."""

from __future__ import annotations

import socket

from huepose.support.errors import InputError
from huepose_services.runtime.config import ViewerConfig


def check_ports_free(config: ViewerConfig) -> None:
    """Raises InputError if a port is taken."""
    everywhere = "0.0.0.0"  # noqa: S104  # where rerun serves the page's program; it has no option for this
    for name, port, bind in (
        ("web_port", config.web_port, everywhere),
        ("grpc_port", config.grpc_port, config.bind),
    ):
        if why := _why_taken(port, bind):
            fix = "Close the other viewer, or choose another port."
            raise InputError(f"viewer.{name} {port}", found=why, expected="a free port", fix=fix)


def free_port(first: int, web_port: int) -> int:
    """The first free port of this machine from `first` on, so that several viewers can run side by side; not
    that of the page itself."""
    for port in range(first, min(first + 100, 65_536)):
        if port != web_port and not _why_taken(port, "127.0.0.1"):
            return port
    raise InputError(f"ports from {first}", found="100 that are taken", expected="a free one")


def _why_taken(port: int, bind: str) -> str:
    """Why the port cannot be used; empty if it can."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError as error:
            return error.strerror or str(error)
    return ""
