"""CPU time of the sender of poses, by the number of readers: five poses at 30 Hz over sockets, as the tracker
sends them."""

from __future__ import annotations

import multiprocessing
import tempfile
import threading
import time
from collections.abc import Sequence

import zenoh

from huepose.support.progress import progress
from huepose_protos.codec import encode
from huepose_protos.examples import example
from huepose_protos.local import endpoint
from huepose_protos.messages import PoseMessage
from huepose_services.runtime.session import zenoh_config

POSES, RATE_HZ, SECONDS = 5, 30.0, 6.0
"""Number of objects whose poses are published, rate, and duration."""

READERS_COME_S = 12.0
"""Time for all readers to subscribe."""

_KEY = "huepose/growth/pose"


def readers(counts: Sequence[int]) -> dict[str, list[tuple[float, float]]]:
    """CPU milliseconds per second of the sender, by the number of readers, each with its own session."""
    curves: dict[str, list[tuple[float, float]]] = {"send five poses": []}
    context = multiprocessing.get_context("spawn")
    for count in progress(counts, "readers"):
        with tempfile.TemporaryDirectory() as folder, context.Pool(1) as pool:
            there = endpoint(1, folder)
            spent = pool.apply_async(sent_ms, (there,))
            time.sleep(1.5)
            sessions = [zenoh.open(zenoh_config([], [there])) for _ in range(count)]
            heard = [threading.Event() for _ in sessions]
            for session, event in zip(sessions, heard, strict=True):
                session.declare_subscriber(f"{_KEY}/*", lambda sample, event=event: event.set())
            curves["send five poses"].append((count, float(spent.get(120))))
            for session in sessions:
                session.close()
            if not all(event.is_set() for event in heard):
                raise RuntimeError(f"not all of {count} readers heard a pose")
    return curves


def sent_ms(there: str) -> float:
    """CPU milliseconds per second of a process that sends poses, after its readers had time to subscribe."""
    session = zenoh.open(zenoh_config([there], []))
    publishers = [session.declare_publisher(f"{_KEY}/{k}") for k in range(POSES)]
    time.sleep(READERS_COME_S)
    message = example(PoseMessage)
    before, start = time.process_time(), time.perf_counter()
    for i in range(int(SECONDS * RATE_HZ)):
        for publisher in publishers:
            publisher.put(encode(message))
        time.sleep(max(0.0, start + (i + 1) / RATE_HZ - time.perf_counter()))
    spent = time.process_time() - before
    session.close()
    return 1e3 * spent / SECONDS
