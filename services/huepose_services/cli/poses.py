"""`huepose poses`: prints what a pipeline publishes, one message a line, here or through a gateway."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from huepose_services.cli.attach import add_choice, chosen
from huepose_services.cli.options import until_told
from huepose_services.cli.remote import add_gateway, gateway_of

if TYPE_CHECKING:
    from huepose_protos.client import Reader
    from huepose_protos.messages import Message

_GONE_AFTER_S = 1.0
_SAY_WAITING_AFTER_S = 3.0


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser("poses", help="print the poses of a running pipeline")
    parser.add_argument(
        "key",
        nargs="?",
        default="pose/**",
        metavar="KEY",
        help="what to print, after huepose/SITE/CAMERA/ (default: pose/**; also health/**, objects, truth)",
    )
    parser.add_argument("--json", action="store_true", help="one wire message a line, as JSON")
    add_choice(parser)
    add_gateway(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Print until interrupted, or until the pipeline that was seen here is gone."""
    gateway, stopping = gateway_of(arguments), until_told()

    if gateway is None:
        _print_until_gone(arguments, stopping)
    else:
        for message in gateway.messages(arguments.key, stopping):
            _print(message, arguments.json)
    return 0


def _print_until_gone(arguments: argparse.Namespace, stopping: Callable[[], bool]) -> None:
    from huepose_protos.client import Reader

    pipeline, again, say_at = chosen(arguments), True, time.monotonic() + _SAY_WAITING_AFTER_S
    while again and not stopping():
        endpoints, key = pipeline.endpoints, pipeline.key(arguments.key)
        with Reader(endpoints, key) as reader:
            again = False
            while not stopping() and not _is_over(reader) and not again:
                message = reader.next(0.1)
                if message is not None:
                    say_at = float("inf")
                    _print(message, arguments.json)
                    continue
                if time.monotonic() > say_at:
                    # Once for a pipeline that is not there, once for one that says nothing.
                    say_at = float("inf")
                    print(_silence(reader, endpoints[0], key), file=sys.stderr, flush=True)
                if not reader.seen:
                    before, pipeline = pipeline, chosen(arguments)
                    again = pipeline != before


def _silence(reader: Reader, endpoint: str, key: str) -> str:
    if not reader.seen:
        return f"waiting for a pipeline at {endpoint}; `huepose up` starts one"
    return f"a pipeline runs, but nothing is said on {key} yet; `huepose status` says how it is"


def _is_over(reader: Reader) -> bool:
    """The pipeline was there, and has been gone for a while."""
    if not reader.seen or reader.live or reader.gone_since is None:
        return False
    return reader.pending == 0 and time.monotonic() - reader.gone_since >= _GONE_AFTER_S


def _print(message: Message, as_json: bool) -> None:
    from huepose_protos import to_json
    from huepose_protos.messages import PoseMessage

    if as_json or not isinstance(message, PoseMessage):
        print(to_json(message), flush=True)
        return
    where = "no pose"
    if message.translation is not None and message.quaternion is not None:
        x, y, z = message.translation
        qx, qy, qz, qw = message.quaternion
        where = f"{x:+.4f} {y:+.4f} {z:+.4f} m   {qx:+.4f} {qy:+.4f} {qz:+.4f} {qw:+.4f}"
    age_ms = (message.publish_ns - message.capture_ns) * 1e-6
    who = f"{message.frame_id:6d} {message.object}/{message.instance:<3d} {message.state:9s}"
    print(f"{who} {message.quality:.2f}  {where}  {age_ms:.0f} ms  {message.reason}".rstrip(), flush=True)
