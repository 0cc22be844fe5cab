"""`huepose poses`: prints what a pipeline publishes, one message a line, until the pipeline is gone."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

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
    parser.add_argument(
        "--config", type=Path, metavar="PIPELINE", help="the pipeline's configuration, for its ports"
    )
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Print until the pipeline that was seen is gone, or until interrupted."""
    from huepose_protos.client import Reader
    from huepose_services.runtime.config import WORKERS

    stopping = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    ports = _base_ports(arguments.config)
    endpoints = [f"tcp/127.0.0.1:{port + place}" for port in ports for place in range(len(WORKERS))]
    with Reader(endpoints, f"huepose/*/*/{arguments.key}") as reader:
        _follow(reader, arguments.json, endpoints[0], lambda: stopping)
    return 0


def _base_ports(path: Path | None) -> list[int]:
    """Where to look: as configured, else where pipelines run and where the next one usually would."""
    from huepose_services.runtime.config import DEFAULT_FILE, BusConfig, load
    from huepose_services.runtime.running import base_ports

    if path is not None:
        return [load(path).bus.base_port]
    usual = load(Path(DEFAULT_FILE)).bus.base_port if Path(DEFAULT_FILE).exists() else BusConfig().base_port
    return list(dict.fromkeys([*base_ports(), usual]))


def _follow(reader: Reader, as_json: bool, endpoint: str, stopping: Any) -> None:
    started, gone_since, told = time.monotonic(), None, False
    while not stopping():
        message = reader.next(0.1)
        if message is not None:
            _print(message, as_json)
            gone_since = None
            continue
        now = time.monotonic()
        if reader.seen and not reader.live:
            gone_since = now if gone_since is None else gone_since
            if now - gone_since >= _GONE_AFTER_S:
                return
        elif not reader.seen and not told and now - started > _SAY_WAITING_AFTER_S:
            told = True
            print(f"waiting for a pipeline at {endpoint}", file=sys.stderr, flush=True)


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
    print(f"{who} {message.quality:.2f}  {where}  {age_ms:.0f} ms", flush=True)
