"""`huepose chaos`: inject faults into a running pipeline, and check what still holds."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from typing import Any

from huepose.support.errors import InputError
from huepose_services.cli.options import (
    add_json,
    add_number,
    add_several,
    over_zero,
    print_result,
    say,
    stop_as_interrupt,
)


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "chaos", help="inject faults into a pipeline on the built-in scene, and check what still holds"
    )
    add_number(parser, "--minutes", None, "duration (default: each fault once)", kind=over_zero)
    add_several(
        parser, "--only", "WORD", "only faults with this word in their name, or this number", [], kind=str
    )
    add_number(
        parser,
        "--slow",
        1.0,
        "divide the frame rate by this, and multiply all time limits by it",
        "F",
        over_zero,
    )
    add_json(parser, to_file=True)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Inject one fault after the other; exit code 1 if something did not hold."""
    from huepose_services.chaos.faults import FAULTS
    from huepose_services.chaos.memory import growth
    from huepose_services.chaos.outcome import Outcome, cells, strike, table
    from huepose_services.chaos.system import LivePipeline

    words = arguments.only
    chosen = [f for f in FAULTS if not words or any(w == str(f.number) or w in f.name.split() for w in words)]
    if not chosen:
        raise InputError(
            "--only", found=" ".join(words), expected="numbers or words of faults (docs/reliability.md)"
        )
    outcomes: list[Outcome] = []
    stop_as_interrupt()  # the pipeline is stopped
    with LivePipeline(live=True, slow=arguments.slow) as system:
        if not system.wait_until_steady(3, 300.0):
            say(f"huepose chaos: the pipeline does not become steady:\n{system.log()[-3000:]}")
            return 1
        start = time.monotonic()
        until = start + 60.0 * (arguments.minutes or 0.0)
        while not outcomes or time.monotonic() < until:
            for fault in chosen:
                outcomes.append(strike(system, fault, 60.0 + 30.0 * arguments.slow))
                say("  ".join(cells(outcomes[-1])))
                if arguments.minutes and time.monotonic() > until:
                    break
        grown = growth(system.health_log, start, until_s=time.monotonic())
    text = table(outcomes)
    memory = {worker: asdict(one) for worker, one in grown.items()}
    found = {"faults": [asdict(o) for o in outcomes], "memory": memory}
    lines = [text, *(f"{worker:10s} {one}" for worker, one in grown.items())]
    print_result(arguments, found, "\n".join(lines))
    return 1 if any(o.broken for o in outcomes) else 0
