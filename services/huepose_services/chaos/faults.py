"""The faults that can be injected into a running pipeline, each with the checks of its own.

The checks that all have in common are in `outcome`. The numbers are those of docs/reliability.md.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from huepose_protos import PoseClient
from huepose_protos.keys import Keys
from huepose_protos.messages import ControlRequest, ObjectEntry
from huepose_services.chaos import intruder
from huepose_services.chaos.intruder import flood
from huepose_services.chaos.system import LivePipeline
from huepose_services.cli.objects import ask
from huepose_services.runtime.clock import now_ns

_LONGER_THAN_KEPT_S = 6.0
"""Longer than the tracker keeps frames, at 30 images a second and with the default configuration."""

Strike = Callable[[LivePipeline], AbstractContextManager[list[str]]]
"""A context in which the fault is there; the list gets checks that failed, in words."""


@dataclass(frozen=True)
class Fault:
    """number: in the table; worker: the only one that may die of it; said: a pattern that log or health must
    show, if the fault has to be noticed; seconds: its duration; refused: it puts messages on the bus that no
    reader can decode."""

    number: int
    name: str
    strike: Strike
    said: str = ""
    seconds: float = 4.0
    worker: str | None = None
    refused: bool = False


@contextmanager
def _ordered(system: LivePipeline, orders: dict[str, object]) -> Iterator[list[str]]:
    system.order(**orders)
    try:
        yield []
    finally:
        system.order()


def camera(number: int, name: str, said: str = "", seconds: float = 4.0, **orders: object) -> Fault:
    """A fault of the camera, which works again afterwards."""
    return Fault(number, name, partial(_ordered, orders=orders), said, seconds)


@contextmanager
def _signalled(worker: str, number: signal.Signals, system: LivePipeline) -> Iterator[list[str]]:
    os.kill(system.pids()[worker], number)
    yield []


@contextmanager
def _without_memory(worker: str, system: LivePipeline) -> Iterator[list[str]]:
    """The system refuses all further memory to a worker."""
    pid = system.pids()[worker]
    fields = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    taken = int(fields["VmSize"].split()[0]) * 1024
    _, hard = resource.prlimit(pid, resource.RLIMIT_AS)
    resource.prlimit(pid, resource.RLIMIT_AS, (taken, hard))
    yield []
    with suppress(ProcessLookupError):
        resource.prlimit(pid, resource.RLIMIT_AS, (hard, hard))


@contextmanager
def _throttled(system: LivePipeline, workers: tuple[str, ...]) -> Iterator[list[str]]:
    """These workers run for a third of the time, as on a processor that is too hot."""
    pids = [system.pids()[worker] for worker in workers]
    stopping = threading.Event()

    def work() -> None:
        while not stopping.is_set():
            for number, seconds in ((signal.SIGSTOP, 0.02), (signal.SIGCONT, 0.01)):
                for pid in pids:
                    with suppress(ProcessLookupError):
                        os.kill(pid, number)
                stopping.wait(seconds)
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield []
    finally:
        stopping.set()
        thread.join()


@contextmanager
def _started_twice(system: LivePipeline, worker: str) -> Iterator[list[str]]:
    command = [sys.executable, "-m", "huepose_services.cli.main", "run", worker, str(system.path)]
    second = subprocess.run(command, capture_output=True, text=True, timeout=120.0, check=False)
    yield (
        [] if second.returncode == 2 else [f"the second {worker} ended with {second.returncode}, not with 2"]
    )


@contextmanager
def _flooded(system: LivePipeline) -> Iterator[list[str]]:
    counted = {worker: message.errors for worker, message in system.health.items()}
    sent = flood(system.endpoints, Keys("local", "cam0"), 4.0)
    time.sleep(1.5)
    broken = [] if sent > 1000 else [f"only {sent} bad messages could be sent"]
    readers = {"tracker", "reinit", "detector", "segmenter", "estimator"}
    silent = {w for w in readers if system.health[w].errors <= counted[w]}
    yield broken + [f"{worker} counted no bad message" for worker in sorted(silent)]


@contextmanager
def _intruded(system: LivePipeline, what: str) -> Iterator[list[str]]:
    key = system.pipeline.key
    name = sorted(system.tracking_now() or {"tea_box"})[0]
    send, rate_hz = {
        "old frames": (lambda s, f: intruder.send_old_frames(s, f, key("frame")), 30.0),
        "camera": (lambda s, f: intruder.send_frames_of_another_camera(s, f, key("frame")), 10.0),
        "masks": (lambda s, f: intruder.send_bad_masks(s, f, key("perception/masks"), name), 5.0),
        "corrections": (
            lambda s, f: intruder.send_late_corrections(
                s, system.corrections, key("correction"), _LONGER_THAN_KEPT_S * system.slow
            ),
            5.0,
        ),
    }[what]
    with intruder.repeating(system, rate_hz, send):
        yield []


@contextmanager
def _gateway_killed(system: LivePipeline) -> Iterator[list[str]]:
    broken: list[str] = []
    with PoseClient(f"tcp/127.0.0.1:{system.gateway_port}") as client:
        _expect(broken, "a reader gets poses", lambda: client.latest(max_age_s=1.0) is not None)
        os.kill(system.pids()["gateway"], signal.SIGKILL)
        _expect(broken, "a reader sees that the gateway is gone", lambda: not client.connected)
        yield broken
        _expect(broken, "a reader gets poses again", lambda: client.latest(max_age_s=1.0) is not None, 60.0)


class Relay:
    """A cable between a reader and a gateway: listens on `port` of this machine and forwards everything to
    another port, unless it is `cut`. Then it holds back what is sent, and closes no connection."""

    def __init__(self, to_port: int) -> None:
        self.cut = False
        self._to_port = to_port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._stopping = False
        self._links: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while not self._stopping:
            with suppress(OSError):
                near, _ = self._listener.accept()
                far = socket.create_connection(("127.0.0.1", self._to_port))
                self._links += [near, far]
                threading.Thread(target=self._pass_on, args=(near, far), daemon=True).start()

    def _pass_on(self, near: socket.socket, far: socket.socket) -> None:
        other = {near: far, far: near}
        with suppress(OSError):
            while not self._stopping:
                if self.cut:
                    time.sleep(0.02)
                    continue
                for ready in select.select([near, far], [], [], 0.1)[0]:
                    data = ready.recv(65_536)
                    if not data:
                        raise OSError
                    other[ready].sendall(data)
        for end in (near, far):
            end.close()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        self._listener.close()
        for link in self._links:
            link.close()


@contextmanager
def _cable_cut(system: LivePipeline) -> Iterator[list[str]]:
    """Nothing passes between gateway and reader for three seconds, and no connection is closed."""
    broken: list[str] = []
    with Relay(system.gateway_port) as relay, PoseClient(f"tcp/127.0.0.1:{relay.port}") as client:
        _expect(broken, "a reader gets poses", lambda: client.latest(max_age_s=1.0) is not None)
        relay.cut = True
        time.sleep(3.0)
        if client.latest(max_age_s=2.0) is not None or client.at() is not None or client.silent_s() < 2.0:
            broken.append("a reader takes old poses for new ones while the cable is cut")
        relay.cut = False
        yield broken
        _expect(broken, "a reader gets poses again", lambda: client.latest(max_age_s=1.0) is not None, 60.0)


@contextmanager
def _many_objects(system: LivePipeline) -> Iterator[list[str]]:
    """Ten instances of each object are searched for, while only one is there."""
    names = {entry.object for entry in _answered(system, "list")}
    for name in names:
        _answered(system, "add", name, 10)
    yield [] if names else ["no object is searched for"]
    for name in names:
        _answered(system, "add", name)


def _answered(
    system: LivePipeline, action: Literal["list", "add"], name: str | None = None, count: int = 1
) -> list[ObjectEntry]:
    request = ControlRequest(publish_ns=now_ns(), action=action, object=name, max_instances=count)
    reply = ask(system.pipeline, request)
    return [] if reply is None else reply.objects


def _expect(broken: list[str], what: str, condition: Callable[[], bool], within_s: float = 20.0) -> None:
    until = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > until:
            broken.append(f"not so within {within_s:g} s: {what}")
            return
        time.sleep(0.05)


_WORKERS = ("camera", "tracker", "reinit", "detector", "segmenter", "estimator")
NO_DEPTH = "no depth:"
_SILENT = "has given no sign of life"

FAULTS: tuple[Fault, ...] = (
    # The scene without a fault, once through its loop.
    camera(0, "nothing is broken", seconds=30.0),
    camera(1, "camera unplugged", "the connection is lost", 3.0, unplugged=True),
    camera(2, "last image for ever", "no new image for 2 s", 4.0, frozen="stamps"),
    camera(2, "last image with new timestamps", "no new image for 2 s", 4.0, frozen="pixels"),
    camera(2, "rate falls to a third", "images a second instead of", rate_share=0.33),
    camera(2, "black image", "its image is black", dark=True),
    camera(3, "device clock 10 s ahead", seconds=3.0, jump_s=10.0),
    camera(3, "device clock 4 s back", seconds=3.0, jump_s=-4.0),
    camera(4, "device clock drifts by 7.5e-5", seconds=8.0, drift=7.5e-5),
    camera(6, "depth 1 image late", "older than colour", depth_late=1),
    camera(6, "depth 3 images late", "older than colour", depth_late=3),
    camera(6, "depth 5 images late", "older than colour", depth_late=5),
    *(camera(7, f"depth all {kind}", NO_DEPTH, depth=kind) for kind in ("zero", "nan", "inf", "largest")),
    camera(7, "depth with holes of all kinds", depth="holes"),
    Fault(8, "empty masks, masks of another size", partial(_intruded, what="masks")),
    camera(9, "half the size", "its image changed from", half_size=True),
    camera(9, "focal length 1.5 times too long", "its image changed from", focal_share=1.5),
    Fault(12, "a reader that takes 100 ms each", partial(intruder.slow_reader, delay_s=0.1)),
    *(
        Fault(13, f"{w} killed", partial(_signalled, w, signal.SIGKILL), f"{w} killed by signal", worker=w)
        for w in _WORKERS
    ),
    *(
        Fault(13, f"{w} stopped", partial(_signalled, w, signal.SIGSTOP), f"{w} {_SILENT}", 10.0, w)
        for w in _WORKERS
    ),
    *(Fault(13, f"{w} gets no memory", partial(_without_memory, w), "", 6.0, w) for w in _WORKERS),
    Fault(15, "bad messages on every key", _flooded, refused=True, seconds=0.0),
    Fault(16, "frames twice and out of order", partial(_intruded, what="old frames")),
    Fault(17, "gateway killed", _gateway_killed, "gateway killed by signal", worker="gateway"),
    Fault(17, "cable cut", _cable_cut, seconds=0.5),
    Fault(18, "no shared memory left", intruder.hoarder, seconds=8.0),
    Fault(20, "tracker three times slower", partial(_throttled, workers=("tracker",)), seconds=8.0),
    Fault(
        20,
        "perception three times slower",
        partial(_throttled, workers=("detector", "segmenter", "estimator")),
        seconds=8.0,
    ),
    Fault(
        # In the log, where repeats may be held back for minutes, or in the tracker's health.
        21,
        "corrections older than what is kept",
        partial(_intruded, what="corrections"),
        "what it finds cannot be used",
        seconds=12.0,
    ),
    Fault(22, "a second camera under one key", partial(_intruded, what="camera")),
    *(
        Fault(22, f"{worker} started twice", partial(_started_twice, worker=worker), seconds=1.0)
        for worker in _WORKERS
    ),
    Fault(25, "ten times as many objects", _many_objects, seconds=15.0),
)
