"""`huepose status` and `huepose top`: the state of a running pipeline, once or every second."""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

from huepose_services.cli.options import add_choice, add_seconds, catch_stop_signals, chosen, say

if TYPE_CHECKING:
    from huepose_protos.messages import HealthMessage, PoseMessage
    from huepose_services.watch import View

# Health comes once a second; from a worker in the middle of a long task it comes later.
_LEAST_S, _MOST_S = 1.2, 4.0
_CLEAR, _EVERY_S = "\x1b[H\x1b[J", 1.0


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("status", help="show the state of a running pipeline")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    add_choice(parser)
    parser.set_defaults(call=call)
    again = subparsers.add_parser("top", help="show the state of a running pipeline every second")
    add_seconds(again, "end after this time (default: never)")
    add_choice(again)
    again.set_defaults(call=call_again)


def call(arguments: argparse.Namespace) -> int:
    """Listen for a moment, print; exit code 1 if nothing runs, or a worker is missing or silent."""
    from huepose_services.watch import Watch

    pipeline = chosen(arguments, tell=False)  # the first line names it
    with Watch(pipeline) as watch:
        watch.look_at_all(_LEAST_S, _MOST_S)
        view = watch.view()
    if arguments.json:
        print(_as_json(view))
    elif not view.seen:
        say(f"huepose status: {pipeline.absence}")
    else:
        print(as_text(view, _width()))
    return 0 if view.well else 1


def call_again(arguments: argparse.Namespace) -> int:
    """Show the state every second until interrupted."""
    from huepose_services.watch import Watch

    pipeline = chosen(arguments, tell=False)  # the first line names it
    until = float("inf") if arguments.seconds is None else time.monotonic() + arguments.seconds
    stopping = catch_stop_signals()
    with Watch(pipeline) as watch:
        shown = ""
        while not stopping() and time.monotonic() < until:
            watch.look(_EVERY_S, stopping)
            view = watch.view()
            text = as_text(view, _width()) if view.seen else pipeline.absence
            if text != shown:
                sys.stdout.write((_CLEAR if sys.stdout.isatty() else "") + text + "\n")
                sys.stdout.flush()
            shown = text
    return 0


def _as_json(view: View) -> str:
    import msgspec

    from huepose_services.runtime.text import encodable

    return msgspec.json.encode(
        {
            "pipeline": msgspec.structs.replace(view.pipeline, file=encodable(view.pipeline.file)),
            "running": view.seen,
            "played": view.pipeline.played,
            "well": view.well,
            "missing": view.missing,
            "silent": sorted(view.silent),
            "workers": view.health,
            "objects": view.objects or [],
            "poses": list(view.poses.values()),
            "rates_hz": view.rates,
        }
    ).decode()


_COLUMNS = {
    "worker": "<10", "state": "<9", "rate": ">6", "work ms": ">13", "age ms": ">13", "CPU": ">5", "MiB": ">5",
    "locked": ">6", "frames by": ">10", "drops": ">7", "errors": ">6", "restarts": ">8",
}  # fmt: skip
"""The columns, each with its format."""

_HEAD = {name: name for name in _COLUMNS}
_GO_FIRST = ("locked", "frames by", "MiB", "age ms", "work ms")
"""Columns that are left out first if the terminal is too narrow."""


def _shown(width: int | None) -> list[str]:
    """The columns that fit into `width` characters; all if it is None."""
    shown = list(_COLUMNS)
    for name in _GO_FIRST:
        if width is None or len(_row(_HEAD, shown)) <= width:
            break
        shown.remove(name)
    return shown


def _row(cells: Mapping[str, str], shown: Sequence[str]) -> str:
    """One line of the table."""
    return " ".join(f"{cells[name]:{_COLUMNS[name]}}" for name in shown)


def _width() -> int | None:
    """Width of the terminal in characters; None if the output is no terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def as_text(view: View, width: int | None = None) -> str:
    """The state as lines: one for each worker, then one for each object. width: characters that the table of
    workers may take; None for no limit."""
    from huepose_services.runtime.config import WORKERS

    lines = [f"{view.pipeline.name} at port {view.pipeline.base_port}   {view.pipeline.file}".rstrip()]
    if view.pipeline.played:
        lines.append("a recording is played: its workers are shown as they were then, none runs now")
    shown = _shown(width)
    lines.append(_row(_HEAD, shown))
    order = [w for w in WORKERS if w in view.health or w in view.missing or w in view.silent]
    for worker in order:
        message = view.health.get(worker)
        if worker in view.missing:
            lines.append(f"{worker:10s} is not there: starting, stopping or ended; the log says which")
        elif message is None:
            lines.append(f"{worker:10s} is there, but sends no health messages")
        else:
            lines.append(_row(_worker(message, worker in view.silent), shown))
    said: dict[str, str] = {}
    for message in sorted(view.health.values(), key=lambda m: m.worker != "camera"):
        for text in message.warnings:
            # A warning of the camera that other workers repeat is printed once, as the camera's.
            if text not in said:
                said[text] = message.worker
                lines.append(f"  {message.worker}: {text}")
        if message.last_error:
            lines.append(f"  {message.worker}, last error: {message.last_error.splitlines()[0]}")
    lines.append("")
    if view.pipeline.elsewhere:
        return "\n".join([*lines, view.pipeline.elsewhere])
    camera = view.health.get("camera")
    rows = [(_pose(pose), _cause(pose, camera)) for pose in view.poses.values()]
    with_poses = {name for name, _ in view.poses}
    if view.objects == []:
        lines.append("no object is searched for; `huepose objects add NAME` adds one")
    for entry in view.objects or []:
        if entry.searching:
            text = f"SEARCHING  {entry.searching} of {entry.max_instances} not found yet"
        elif entry.object not in with_poses:
            text = "no pose    it was found before, but no pose of it arrives now"
        else:
            continue
        known = camera.picture if camera is not None and entry.reason else ""
        rows.append((f"{entry.object:32s} {text}", known or entry.reason))
    for reason, group in groupby(rows, key=lambda row: _without(said, row[1])):
        together = [row for row, _ in group]
        lines += together
        if reason:
            lines.append(f"  {reason}" if len(together) == 1 else f"  These {len(together)}: {reason}")
    return "\n".join(lines)


def _without(said: dict[str, str], reason: str) -> str:
    """A reason in which a warning that was printed above is replaced by a reference to it.

    said: the worker of each printed warning, by its text.

    >>> _without({"cam: slow": "camera"}, "No image comes. cam: slow")
    'No image comes. See the camera above.'
    """
    for text, worker in said.items():
        if text in reason:
            return reason.replace(text, f"See the {worker} above.")
    return reason


def _worker(m: HealthMessage, silent: bool) -> dict[str, str]:
    return {
        "worker": m.worker,
        "state": "silent" if silent else m.state,
        "rate": f"{m.rate_hz:.1f}",
        "work ms": _pair(m.work_ms),
        "age ms": _pair(m.age_ms),
        "CPU": f"{m.cpu_percent:.0f}%",
        "MiB": f"{m.memory_mib:.0f}",
        "locked": f"{m.locked_mib:.1f}",
        "frames by": {None: "-", True: "memory", False: "socket"}[m.shared_memory],
        "drops": f"{m.drops}",
        "errors": f"{m.errors}",
        "restarts": f"{m.restarts}",
    }


def _pair(values: tuple[float, float] | None) -> str:
    return "-" if values is None else f"{values[0]:.0f} p99 {values[1]:.0f}"


def _pose(pose: PoseMessage) -> str:
    who = f"{pose.object}/{pose.instance}"
    text = f"{who:32s} {pose.state:9s}  quality {pose.quality:.2f}"
    if pose.translation is not None:
        x, y, z = pose.translation
        text += f"  {x:+.3f} {y:+.3f} {z:+.3f} m"
    return f"{text}  {pose.age_ms:.0f} ms old"


def _cause(pose: PoseMessage, camera: HealthMessage | None) -> str:
    """Why a pose is not TRACKING: the camera's fault (`picture`) if any, because it causes the others.
    For a frame after the camera's message it is the pose's own reason, which includes such a fault."""
    if not pose.reason or camera is None or pose.capture_ns > camera.publish_ns:
        return pose.reason
    return camera.picture or pose.reason
