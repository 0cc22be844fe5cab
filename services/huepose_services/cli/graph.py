"""`huepose graph`: the messages between workers and their rates, as a Mermaid flowchart."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from huepose_services.cli.options import add_choice, add_json, chosen, print_result, say, say_if_unknown

if TYPE_CHECKING:
    from huepose_services.watch import View

_LOOK_S = 3.0
# Sender, receiver, message, and what gives the rate: a worker's own rate, or a kind of message that is
# counted.
_EDGES = (
    ("camera", "tracker", "frame", "camera"),
    ("camera", "detector", "frame", "camera"),
    ("reinit", "detector", "request", "request"),
    ("detector", "segmenter", "boxes + frame", "detector"),
    ("segmenter", "estimator", "masks + frame", "segmenter"),
    ("estimator", "reinit", "estimates", "estimates"),
    ("reinit", "tracker", "correction", "correction"),
    ("tracker", "reinit", "pose", "pose"),
    ("tracker", "gateway", "pose", "pose"),
    ("tracker", "viewer", "pose", "pose"),
    ("camera", "viewer", "frame", "camera"),
    ("tracker", "ros2", "pose", "pose"),
)
_COUNTED = ("request", "estimates", "correction", "pose")


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("graph", help="show the workers and their rates as a Mermaid flowchart")
    add_choice(parser)
    add_json(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Listen for some seconds, then print the flowchart."""
    from huepose_services.watch import Watch

    pipeline = chosen(arguments)
    say_if_unknown(pipeline)
    with Watch(pipeline) as watch:
        watch.look(_LOOK_S)
        view = watch.view()
    if not view.seen:
        say(f"huepose graph: {pipeline.absence}")
    if view.seen or arguments.json:
        print_result(arguments, as_json(view), mermaid(view))
    return 0 if view.seen else 1


def as_json(view: View) -> dict[str, Any]:
    """The workers, and the messages between them; unknown values are None. host: the second computer, for a
    worker that runs there."""
    far = set(view.pipeline.far)

    def about(worker: str) -> dict[str, Any]:
        message = view.health.get(worker)
        return {
            "worker": worker,
            "host": view.pipeline.host if worker in far else None,
            "there": view.seen and worker not in view.missing,
            "cpu_percent": message and message.cpu_percent,
            "memory_mib": message and message.memory_mib,
        }

    return {
        "pipeline": view.pipeline.name,
        "running": view.seen,
        "workers": [about(worker) for worker in _workers(view)],
        "edges": [dict(zip(("from", "to", "what", "rate_hz"), edge, strict=True)) for edge in _edges(view)],
    }


def mermaid(view: View) -> str:
    """The flowchart; workers that are not there are drawn dashed."""
    workers, far = _workers(view), set(view.pipeline.far)
    lines = ["flowchart LR"]

    def add(worker: str) -> None:
        message = view.health.get(worker)
        doing = f"<br/>{message.cpu_percent:.0f} % CPU, {message.memory_mib:.0f} MiB" if message else ""
        lines.append(f'    {worker}["{worker}{doing}"]')

    for worker in workers:
        if worker not in far:
            add(worker)
    if far:
        lines.append(f"    subgraph {view.pipeline.host}")
        for worker in workers:
            if worker in far:
                add(worker)
        lines.append("    end")
    for source, target, what, rate_hz in _edges(view):
        label = what if rate_hz is None else f"{what}, {rate_hz:.1f} Hz"
        if (source in far) == (target in far):
            lines.append(f'    {source} -- "{label}" --> {target}')
            continue
        there, back = ("uplink", "downlink") if target in far else ("downlink", "uplink")
        lines.append(f'    {source} -- "{label}" --> {there}')
        lines.append(f"    {there} == TLS ==> {back}")
        lines.append(f"    {back} --> {target}")
    gone = [w for w in workers if w in view.missing] if view.seen else []
    if gone:
        lines += ["    classDef gone stroke-dasharray: 5 5", f"    class {','.join(gone)} gone"]
    return "\n".join(lines)


def _workers(view: View) -> list[str]:
    from huepose_services.runtime.config import CHAIN

    return list(view.pipeline.workers) or [*CHAIN, *(w for w in view.health if w not in CHAIN)]


def _edges(view: View) -> Iterator[tuple[str, str, str, float | None]]:
    """Sender, receiver, message, and its rate in Hz; None if the rate is not known."""
    workers, far = _workers(view), set(view.pipeline.far)
    for source, target, what, measure in _EDGES:
        if source not in workers or target not in workers:
            continue
        crosses = (source in far) != (target in far)
        if crosses and source == "camera":
            continue  # the frame goes with the request
        if crosses and what == "request":
            what = "request + frame"
        rate_hz = None
        if measure in _COUNTED:
            rate_hz = view.rates.get(measure, 0.0) if view.seen else None
        elif measure in view.health:
            rate_hz = view.health[measure].rate_hz
        yield source, target, what, rate_hz
