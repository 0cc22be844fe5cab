"""`huepose replay`: plays a recording back on the bus, for viewers and subscribers."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

_SETTLE_S = 1.0


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser = subparsers.add_parser(
        "replay",
        help="play a recording back, for huepose poses, view and subscribers",
        description="Publishes what huepose record wrote, at its times, on the ports of a pipeline. To let a "
        "pipeline estimate poses in the frames anew, set camera.source: bop and camera.path instead.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--config", type=Path, metavar="PIPELINE", help="for names and ports")
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="1: as it was (default)")
    parser.add_argument("--loop", action="store_true", help="again and again")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Play until the end, or until interrupted."""
    from huepose.support.errors import InputError
    from huepose_services.recording.replay import Player, Recording
    from huepose_services.runtime.bus import Bus
    from huepose_services.runtime.clock import SECOND, now_ns
    from huepose_services.runtime.config import Config, load
    from huepose_services.runtime.health import Health
    from huepose_services.runtime.log import Log
    from huepose_services.runtime.running import described, noted
    from huepose_services.runtime.session import open_player_session

    if not 0.05 <= arguments.speed <= 20.0:
        raise InputError("--speed", found=f"{arguments.speed:g}", expected="0.05 to 20")
    recording = Recording(arguments.folder)
    config = Config() if arguments.config is None else load(arguments.config)
    stopping = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    session = open_player_session(config)
    bus = Bus(session, config.keys, "replay", Log("replay"), Health("replay"))
    token = session.liveliness().declare_token(config.keys.live("replay"))
    print(f"{arguments.folder}: {recording.seconds:.1f} s, {len(recording.events)} events", file=sys.stderr)
    with noted(described(config, arguments.config or arguments.folder)):
        # Who waits for a pipeline needs a moment to connect.
        time.sleep(_SETTLE_S)
        again = True
        while again and not stopping:
            player = Player(recording, bus, now_ns(), arguments.speed)
            while not player.finished and not stopping:
                wait_s = (player.due_ns() - now_ns()) / SECOND
                if wait_s > 0:
                    time.sleep(min(wait_s, 0.1))
                else:
                    player.play()
            again = arguments.loop
        time.sleep(_SETTLE_S / 4.0)
    token.undeclare()
    bus.close()
    session.close()
    return 0
