"""`huepose run WORKER`: run one worker in this process."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from typing import Any

from huepose.support.errors import InputError
from huepose_services.cli.options import add_pipeline
from huepose_services.runtime.threads import single_threaded


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("run", help="run one worker of a pipeline in this process")
    parser.add_argument(
        "worker",
        metavar="WORKER",
        help="camera, tracker, reinit, detector, segmenter ...; if the file has several cameras: "
        "CAMERA.WORKER",
    )
    add_pipeline(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Run until a signal stops it."""
    from huepose_services.runtime.tied import SUPERVISOR, end_with

    camera, _, worker = arguments.worker.rpartition(".")
    # Before anything that takes time, because the supervisor may die meanwhile.
    if (supervisor := os.environ.get(SUPERVISOR)) is not None:
        end_with(int(supervisor), ask_first=worker == "camera")
    from huepose_services.runtime.config import WORKERS
    from huepose_services.runtime.config_file import load

    # A request to reload that comes during the start is not needed: the file is still to be read.
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # what nohup has set tells `asked_again`
        signal.signal(signal.SIGHUP, lambda *_: None)
    config = load(arguments.config, camera or None).beside(worker)
    if camera and config.camera.name != camera:  # `load` allows another name for the only camera of a file
        raise InputError(
            f"{arguments.config}: camera {camera}",
            found=f"only the camera {config.camera.name}",
            expected="one of that name",
        )
    if worker not in WORKERS:
        raise InputError(
            f"worker '{worker}'", found="no such worker", expected=f"one of {', '.join(WORKERS)}"
        )
    single_threaded()
    from contextlib import nullcontext

    from huepose_services.runtime.running import described, noted
    from huepose_services.runtime.worker import run_worker

    # If a supervisor started it, that one has already noted the whole pipeline.
    with noted(described(config, arguments.config)) if supervisor is None else nullcontext():
        code = run_worker(worker, config, arguments.config.absolute(), camera or None)
    # Everything is closed; unloading numba and OpenCV would only delay the exit.
    sys.stderr.flush()
    os._exit(code)
