"""Where a rerun recording goes: a page served on this machine, a window, or a file."""

from __future__ import annotations

import os
import socket
from datetime import timedelta
from pathlib import Path
from typing import Any

import rerun as rr

from huepose.support.errors import InputError
from huepose_services.runtime.config import ViewerConfig
from huepose_services.viewer.blueprint import layout
from huepose_services.viewer_ports import check_ports_free

_NAME = "huepose"
_BATCH = timedelta(seconds=0.1)
"""Data of this time are sent together. If rows are sent one by one, rerun's default, a slow page never
catches up."""


def _recording() -> Any:
    return rr.RecordingStream(_NAME, batcher_config=rr.ChunkBatcherConfig(flush_tick=_BATCH))


def served(config: ViewerConfig) -> tuple[Any, str]:
    """A recording for browsers, and the address of its page. Nothing is fetched from the internet.

    Raises InputError if a port is taken."""
    check_ports_free(config)
    recording = _recording()
    sink = rr.GrpcServerSink(config.bind, config.grpc_port, server_memory_limit=f"{config.memory_mib}MiB")
    recording.set_sinks(sink, default_blueprint=layout())
    host = "127.0.0.1" if config.bind == "127.0.0.1" else socket.gethostname()
    source = f"rerun+http://{host}:{config.grpc_port}/proxy"
    rr.serve_web_viewer(web_port=config.web_port, open_browser=False, connect_to=source)
    # The dark theme, for which the colours of states are made; else the browser's theme would be used.
    return recording, f"http://{host}:{config.web_port}/?url={source.replace('+', '%2B')}&theme=dark"


def window(memory_mib: int) -> Any:
    """A recording in a window of its own on this machine's screen."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "a viewer's window",
            found="no screen (DISPLAY and WAYLAND_DISPLAY are not set)",
            fix="Use --web PORT and a browser, or --save FILE.rrd.",
        )
    recording = _recording()
    recording.spawn(memory_limit=f"{4 * memory_mib}MiB", server_memory_limit=f"{memory_mib}MiB")
    recording.send_blueprint(layout())
    return recording


def saved(path: Path) -> Any:
    """A recording into a file. `disconnect()` at the end completes it. Raises InputError if the file cannot
    be written."""
    recording = _recording()
    try:
        recording.save(path, default_blueprint=layout())
    except RuntimeError as error:
        found = " ".join(str(error).split())
        raise InputError(path, found=found, expected="a place that can be written") from None
    return recording


MOST_S = 20.0
"""The longest wait for rerun's writer, which may have ended after a write error and then never answers."""


def flushed(recording: Any) -> str:
    """Wait until the whole recording is in its file. Returns why it is not, if writing failed; else an
    empty text."""
    try:
        recording.flush(timeout_sec=MOST_S)
    except RuntimeError as error:  # the writer's own error is in rerun's log
        return f"the file cannot be written any further ({error})"
    return ""
