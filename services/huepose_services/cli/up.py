"""`huepose up`: run all workers of a pipeline, until Ctrl-C or the end of a recording."""

from __future__ import annotations

import argparse
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.words import listed
from huepose_services.cli.options import add_host, add_pipeline, catch_stop_signals

if TYPE_CHECKING:
    from huepose_services.runtime.config import Config
    from huepose_services.runtime.log import Log
    from huepose_services.runtime.supervisor import Supervisor

BAD_INPUT = 2
_POLL_S = 0.1


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("up", help="run a whole pipeline")
    add_pipeline(parser)
    add_host(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Run until the pipeline ends or is interrupted."""
    from concurrent.futures import ThreadPoolExecutor

    from huepose_services.runtime.config_file import load_all
    from huepose_services.runtime.log import Log
    from huepose_services.runtime.prepare import prepare
    from huepose_services.runtime.pulse import notify
    from huepose_services.runtime.reload import asked_again
    from huepose_services.runtime.running import described, namesake, noted
    from huepose_services.runtime.supervisor import Supervisor

    log = Log("huepose")
    again = asked_again()  # from now on: a request that comes during the preparation must not end it
    configs = [config.at(arguments.host) for config in load_all(arguments.config)]
    with ExitStack() as notes:
        # Before the preparation, which may take minutes: other commands then know that it is starting.
        pipelines = [described(config, arguments.config) for config in configs]
        for pipeline in pipelines:
            notes.enter_context(noted(pipeline))
        for config, pipeline in zip(configs, pipelines, strict=True):
            prepare(config)
            if (warning := namesake(pipeline)) is not None:
                log.warn(warning)
        reads_again = signal.getsignal(signal.SIGHUP)
        stopping = catch_stop_signals()
        signal.signal(signal.SIGHUP, reads_again)
        supervisors = [
            Supervisor(config, arguments.config, of=config.camera.name if len(configs) > 1 else None)
            for config in configs
        ]
        try:
            for supervisor in supervisors:
                supervisor.start()
            notified = False
            while _go_on(supervisors) and not stopping():
                asked = again()
                for supervisor in supervisors:
                    supervisor.poll(_POLL_S / len(supervisors))
                    if asked:
                        supervisor.reload()
                if asked:
                    _report_new_cameras(log, arguments.config, configs)
                if not notified and all(supervisor.ready for supervisor in supervisors):
                    notified = True
                    notify("READY=1")
        finally:
            notify("STOPPING=1")
            # All cameras at once: each may take nearly two seconds.
            with ThreadPoolExecutor(len(supervisors)) as pool:
                list(pool.map(Supervisor.stop, supervisors))
    if stopping():
        log.say("stopped")
    return max(supervisor.exit_code or 0 for supervisor in supervisors)


def _report_new_cameras(log: Log, path: Path, configs: list[Config]) -> None:
    """Log which cameras of the file, which was read again, run only after the next start. configs: those
    that run; their supervisors report all else that waits."""
    from huepose_services.runtime.config_file import load_all

    try:
        now = [config.camera.name for config in load_all(path)]
    except InputError:  # the supervisors have reported it
        return
    new = sorted(set(now) - {config.camera.name for config in configs})
    if new and len(now) > 1:
        log.warn(f"cameras that wait for the next start: {listed(new)}")


def _go_on(supervisors: list[Supervisor]) -> bool:
    """Whether the workers of some camera still run, and no configuration is wrong."""
    codes = [supervisor.exit_code for supervisor in supervisors]
    return None in codes and BAD_INPUT not in codes
