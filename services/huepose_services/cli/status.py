"""`huepose status`: how a running pipeline is, once."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from huepose_services.cli.attach import add_choice, chosen

if TYPE_CHECKING:
    from huepose_services.watch import View

# Health comes once a second, and from a worker in the middle of long work later.
_LEAST_S, _MOST_S = 1.2, 4.0


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("status", help="how a running pipeline is")
    parser.add_argument("--json", action="store_true", help="all that is known, as JSON")
    add_choice(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Listen for a moment, print; exit code 1 when nothing runs or a worker is missing."""
    from huepose_services.cli.status_text import as_text
    from huepose_services.watch import Watch

    pipeline = chosen(arguments)
    with Watch(pipeline) as watch:
        watch.look_at_all(_LEAST_S, _MOST_S)
        view = watch.view()
    if arguments.json:
        print(_as_json(view))
    elif not view.seen:
        found = f"no pipeline runs at port {pipeline.base_port}; `huepose up` starts one"
        if pipeline.noted:
            found = f"{pipeline.name} is being started, from {pipeline.file}; its log says how far it is"
        print(f"huepose status: {found}", file=sys.stderr)
    else:
        print(as_text(view))
    return 0 if view.well else 1


def _as_json(view: View) -> str:
    import msgspec

    return msgspec.json.encode(
        {
            "pipeline": view.pipeline,
            "running": view.seen,
            "well": view.well,
            "missing": view.missing,
            "silent": sorted(view.silent),
            "workers": view.health,
            "objects": view.objects,
            "poses": list(view.poses.values()),
            "rates_hz": view.rates,
        }
    ).decode()
