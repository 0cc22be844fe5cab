"""`huepose secure`: make an authority for the gateway, make certificates of readers, and revoke them."""

from __future__ import annotations

import argparse
import shlex
import socket
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from huepose_services.cli.options import add_number, number_of, say

_FOLDER = Path("secure")


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("secure", help="manage certificates of readers on other machines")
    verbs = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    init = verbs.add_parser("init", help="make an authority and the gateway's certificate, in a new folder")
    init.add_argument(
        "--host",
        action="append",
        metavar="NAME",
        help="a name or address by which readers reach this computer; repeat it for more (default: "
        "its own names)",
    )
    add = verbs.add_parser("add", help="make a certificate for a reader")
    revoke = verbs.add_parser("revoke", help="revoke the certificate of a reader")
    host = verbs.add_parser("host", help="add names by which readers reach this computer")
    host.add_argument(
        "names", nargs="+", metavar="NAME", help="a name or address, in addition to the existing ones"
    )
    for verb in (add, revoke):
        verb.add_argument("name", metavar="NAME", help="name of the reader")
    for verb in (init, add, host):
        days = number_of(int, lambda number: 1 <= number <= 36_500, "1 to 36500")
        add_number(verb, "--days", 3650, "days until it expires (3650)", kind=days)
    for verb in (init, add, revoke, host):
        verb.add_argument(
            "--folder", type=Path, default=_FOLDER, metavar="DIR", help="folder of the certificates (secure)"
        )
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Make or revoke certificates, and print how to use them."""
    from huepose_services.authority import AUTHORITY, GATEWAY, REVOKED, Authority

    folder, action = arguments.folder.absolute(), arguments.action
    if action == "init":
        hosts = arguments.host or _own_names()
        Authority.make(folder, hosts, arguments.days)
        files = {"authority": AUTHORITY, "certificate": GATEWAY, "revoked": REVOKED}
        print(f"{folder}: an authority, and the gateway's certificate for {', '.join(hosts)}.")
        print("Keep this folder on this computer. In pipeline.yaml, with `gateway` among the workers:\n")
        print("gateway:\n  listen: 0.0.0.0:7447\n  tls:")
        print("\n".join(f"    {key}: {folder / name}.pem" for key, name in files.items()))
        there = "" if arguments.folder == _FOLDER else f" --folder {shlex.quote(str(arguments.folder))}"
        print(f"    key: {folder / GATEWAY}.key\n\nThen, for each reader: huepose secure add NAME{there}")
        _note_unreachable(hosts)
        return 0
    authority = Authority(folder)
    if action == "add":
        authority.add(arguments.name, arguments.days)
        files_of_reader = [
            authority.certificate(AUTHORITY),
            authority.certificate(arguments.name),
            authority.key(arguments.name),
        ]
        print(f"Copy to {arguments.name}: {' '.join(map(str, files_of_reader))}")
        names = " ".join(path.name for path in files_of_reader)
        print(f"There, as a reader: huepose poses --gateway HOST --tls {names}")
        print("There, as the second computer of a pipeline (`hosts`): put them in the folder `link.secure`")
    elif action == "host":
        hosts = authority.add_hosts(arguments.names, arguments.days)
        print(f"{folder}: the gateway's certificate is now for {', '.join(hosts)}.")
        print("A running gateway uses it within a second. Readers keep their files.")
        _note_unreachable(arguments.names)
    else:
        authority.revoke(arguments.name)
        print(f"{arguments.name} is revoked: a running gateway refuses it within a second.")
    return 0


def _note_unreachable(hosts: Iterable[str]) -> None:
    for host in (host for host in hosts if ":" in host):
        say(f"note: readers cannot reach the IPv6 address {host} over TLS: give a name for it")


def _own_names() -> list[str]:
    name = socket.gethostname().split(".")[0]
    return ["localhost", "127.0.0.1", name, f"{name}.local"]
