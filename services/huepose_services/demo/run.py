"""Run the real pipeline in a private folder, read its messages like any subscriber, and score its poses."""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

import yaml

from huepose.model import load_models
from huepose.support.errors import InputError
from huepose_protos.client import Reader
from huepose_protos.messages import HealthMessage, Message, PoseMessage, TruthMessage
from huepose_services.builtin import builtin_bundles
from huepose_services.camera.synthetic import open_source
from huepose_services.cli.options import catch_stop_signals, say
from huepose_services.demo.score import Score, Yardstick
from huepose_services.demo.table import Table
from huepose_services.runtime.clock import SECOND, now_ns
from huepose_services.runtime.config import WORKERS, Config
from huepose_services.runtime.config_file import load
from huepose_services.runtime.config_perception import is_network_file
from huepose_services.runtime.prepare import check
from huepose_services.runtime.run_folder import free_ports
from huepose_services.runtime.running import described, noted
from huepose_services.runtime.supervisor import Supervisor

_READY_WITHIN_S = 300.0
_FIRST_FRAME_WITHIN_S = 30.0
# The last frames of a run are not counted: some are still in work when it ends.
_LEFT_OUT_NS = SECOND // 2
_COMPLAINT = re.compile(r'\S+ (warn|error) |\{"time": \S+ "level": "(warn|error)"')
"""The beginning of a warning or an error in a log, as text or as JSON."""
_COMPLAINTS = 3
"""Last warnings and errors of the log that are printed if the demo fails; the reason is among them."""


class DemoError(RuntimeError):
    """The pipeline failed; the text names its log, and has the last warnings and errors in it."""


def pipeline(
    seed: int,
    bundles: Path | None = None,
    objects: Sequence[str] = (),
    segmenter: str = "depth",
    sam: Sequence[str] = (),
) -> dict[str, Any]:
    """The pipeline.yaml of the demo. bundles: reference models of other objects than the built-in ones;
    objects: only these, empty for all; sam: the two networks of the segmenter sam, files or names."""
    own = {} if bundles is None else {"bundles": str(bundles.absolute())}
    # The configuration is written to another folder, so paths must be absolute.
    files = [str(Path(one).absolute()) if is_network_file(one) else one for one in sam]
    return {
        "site": "demo",
        **own,
        "objects": [{"name": name} for name in objects],
        "camera": {"source": "synthetic", "seed": seed, "truth": True},
        "segmenter": {"kind": segmenter, **dict(zip(("encoder", "decoder"), files, strict=False))},
        "bus": {"base_port": free_ports(len(WORKERS))},
    }


def run_demo(pipeline: Mapping[str, Any], seconds: float, live: bool) -> dict[str, Any]:
    """Run the pipeline for `seconds`; returns the summary, with the health of each worker at the end.

    pipeline: the content of its pipeline.yaml; live: show a table meanwhile. Before the workers start,
    Ctrl-C interrupts the rendering. Raises InputError if the pipeline cannot start, DemoError if it fails,
    KeyboardInterrupt if it was stopped by a signal."""
    names = [item["name"] for item in pipeline["objects"]] or None
    models = load_models(pipeline.get("bundles") or builtin_bundles(pipeline["camera"]["seed"]), names)
    folder = Path(tempfile.mkdtemp(prefix="huepose-demo-"))
    with ExitStack() as tidied:
        tidied.callback(shutil.rmtree, folder)  # also after a broken output pipe
        path = folder / "pipeline.yaml"
        path.write_text(yaml.safe_dump(dict(pipeline)))
        config = load(path)
        check(config)
        open_source(config)  # renders the scene here, with progress, unless it is in the cache folder
        yardsticks = {
            name: Yardstick.of(model.eval_points, model.diameter_m, model.equivalents)
            for name, model in models.items()
        }
        score = Score(yardsticks)
        log_path = folder / "huepose.log"
        try:
            with log_path.open("w") as log, noted(described(config, path)):
                stopping = catch_stop_signals()
                health = _observe(config, path, log, score, seconds, live, stopping)
        except DemoError as error:
            tidied.pop_all()  # the message names the log, so it stays
            raise DemoError(f"{error}; the log is {log_path}{_complaints(log_path.read_text())}") from None
        except InputError:
            sys.stderr.write(log_path.read_text())
            raise
        if stopping():
            raise KeyboardInterrupt
        if "again (restart " in log_path.read_text():
            tidied.pop_all()
            sys.stderr.write(f"a worker ended and was restarted; the log is {log_path}\n")
    summary = score.summary(score.last_ns - _LEFT_OUT_NS)
    return {"summary": summary, "workers": {name: _brief(message) for name, message in health.items()}}


def _complaints(log: str) -> str:
    """The last warnings and errors of a log, each on a line; empty if there are none."""
    said = [line for line in log.splitlines() if _COMPLAINT.match(line)]
    return "".join(f"\n{line}" for line in said[-_COMPLAINTS:])


def _observe(
    config: Config,
    path: Path,
    log: TextIO,
    score: Score,
    seconds: float,
    live: bool,
    stopping: Callable[[], bool],
) -> dict[str, HealthMessage]:
    """Run the workers and collect what they publish; returns the last health message of each."""
    supervisor = Supervisor(config, path, log)
    endpoints = [config.endpoint(worker) for worker in config.workers]
    health: dict[str, HealthMessage] = {}
    table = Table(sys.stdout) if live else None
    supervisor.start()
    try:
        with Reader(endpoints, config.keys.poses, config.keys.truth, config.keys.health()) as reader:
            _wait_until_ready(supervisor, stopping)
            # Frames count from now on: the camera starts long before the last worker, which may compile.
            score.begin(now_ns())
            started = time.monotonic()
            while not stopping():
                supervisor.poll(0.0)
                if supervisor.exit_code is not None:
                    raise DemoError("the pipeline ended early")
                _take(reader, score, health)
                if table is not None:
                    table.show(score.latest())
                elapsed_ns = 0 if score.first_ns is None else score.last_ns - score.first_ns
                if elapsed_ns >= seconds * SECOND:
                    break
                if score.first_ns is None and time.monotonic() - started > _FIRST_FRAME_WITHIN_S:
                    raise DemoError("the camera gives no frames")
    finally:
        supervisor.stop()
    return health


def _wait_until_ready(supervisor: Supervisor, stopping: Callable[[], bool]) -> None:
    """Print each worker that becomes ready, so that a slow start does not look like a hang."""
    say("starting the workers; if their kernels must be compiled first, this takes one to two minutes")
    started, waiting = time.monotonic(), supervisor.not_ready
    while not supervisor.ready and not stopping():
        supervisor.poll()
        if supervisor.exit_code is not None:
            raise DemoError("a worker could not start")
        if time.monotonic() - started > _READY_WITHIN_S:
            raise DemoError(f"not ready in time: {', '.join(supervisor.not_ready)}")
        for worker in waiting - supervisor.not_ready:
            say(f"  {worker} is ready after {time.monotonic() - started:.0f} s")
        waiting = supervisor.not_ready


def _take(reader: Reader, score: Score, health: dict[str, HealthMessage]) -> None:
    """Take in all messages that have arrived; waits 0.1 s for the first."""
    message: Message | None = reader.next(0.1)
    while message is not None:
        if isinstance(message, PoseMessage):
            score.add_pose(message)
        elif isinstance(message, TruthMessage):
            score.add_truth(message)
        elif isinstance(message, HealthMessage):
            health[message.worker] = message
        message = reader.next(0.0)


def _brief(message: HealthMessage) -> dict[str, Any]:
    return {
        "cpu_percent": round(message.cpu_percent, 1),
        "memory_mib": round(message.memory_mib),
        "rate_hz": round(message.rate_hz, 1),
        "work_ms": message.work_ms,
        "shared_memory": message.shared_memory,
        "counters": message.counters,
        "warnings": message.warnings,
    }
