"""`huepose models`: networks for detector and segmenter."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose_services.cli.options import add_json, print_result

if TYPE_CHECKING:
    from huepose_services.catalogue import Entry


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("models", help="networks for detector and segmenter: list, fetch, add")
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    shown = actions.add_parser("list", help="list known networks, and which are installed (the default)")
    add_json(shown)
    fetched = actions.add_parser("fetch", help="download a known network, or resume the download")
    fetched.add_argument("name", metavar="NAME", help="a name from `huepose models list`")
    fetched.add_argument("--from", dest="url", metavar="URL", help="another address of the same file")
    added = actions.add_parser("add", help="add your own ONNX file")
    added.add_argument("file", type=Path, metavar="FILE", help="the network (.onnx)")
    added.add_argument("--name", help="name for it (default: the file's name)")
    parser.set_defaults(call=call, json=False)


def call(arguments: argparse.Namespace) -> int:
    """List, fetch or add."""
    from huepose_services import catalogue

    if arguments.action == "fetch":
        path = catalogue.fetch(catalogue.entry_of(arguments.name), arguments.url)
        print(f"{path}: installed, and its digest is right")
    elif arguments.action == "add":
        name = arguments.name or arguments.file.stem.lower().replace(".", "_")
        entry = catalogue.add(arguments.file, name)
        print(f"{entry.path}: added as '{name}', SHA-256 {entry.network.sha256}")
    else:
        entries = catalogue.entries()
        summary = "\n".join([*map(_in_words, entries), f"\nfolder: {catalogue.folder()}"])
        facts = [
            asdict(e.network) | {"here": e.here, "path": str(e.path), "size_bytes": _size(e)} for e in entries
        ]
        print_result(arguments, facts, summary)
    return 0


def _size(entry: Entry) -> int | None:
    """Size in bytes: of the installed file, else as the catalogue states it."""
    return entry.path.stat().st_size if entry.here else entry.network.size_bytes


def _in_words(entry: Entry) -> str:
    network, size = entry.network, _size(entry)
    absent = "can be fetched" if network.url and network.sha256 else "add by hand"
    state = "installed" if entry.here else absent
    return f"""{network.name}  [{state}]
    {network.role}
    {network.licence}, {"size not stated" if size is None else f"{size:,} bytes"}
    SHA-256 {network.sha256 or "not stated"}
    {network.source}"""
