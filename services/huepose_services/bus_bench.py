"""Measure how long a frame takes from one process to another, through shared memory and through TCP, over
real sessions.

The time begins before the sender copies the frame and ends when the receiver has arrays: all that a worker
spends on receiving a frame.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from typing import TYPE_CHECKING

import numpy as np
import zenoh

from huepose_protos.local import endpoint
from huepose_services.runtime.bus import is_heard
from huepose_services.runtime.inbox import Inbox, Place
from huepose_services.runtime.run_folder import free_tcp_port
from huepose_services.runtime.session import MIB, zenoh_config

if TYPE_CHECKING:
    from huepose.evaluation.benches import StageTime

# 640x480 pixels: three bytes of colour, two of depth.
FRAME_BYTES, RATE_HZ = 640 * 480 * 5, 30.0
WARM_UP = 5
_KEY = "huepose/bench/frame"
_POOL_BYTES = 6 * MIB
_CONNECT_WITHIN_S = 10.0


def bench_bus(seconds: float = 6.0) -> list[StageTime]:
    """Send frames of 640x480 colour and depth at 30 Hz to a ring of one: `bus/shared_memory` and `bus/tcp`.

    Raises RuntimeError if nothing arrives."""
    # Imported here, because the sender's process imports this module, too, and needs none of it.
    from huepose.evaluation.benches import StageTime

    return [
        StageTime.of("bus/shared_memory", hop_spans(True, seconds)),
        StageTime.of("bus/tcp", hop_spans(False, seconds)),
    ]


def hop_spans(shared_memory: bool, seconds: float) -> list[tuple[float, float]]:
    """(wall, receiver's CPU) seconds of every frame after the first WARM_UP.

    Raises RuntimeError if no frame arrives through the requested transport."""
    with tempfile.TemporaryDirectory() as folder:
        # The endpoint of a pipeline, or TCP for comparison.
        address = endpoint(1, folder) if shared_memory else f"tcp/127.0.0.1:{free_tcp_port()}"
        context = multiprocessing.get_context("spawn")
        sender = context.Process(target=_send, args=(address, shared_memory, seconds), daemon=True)
        session = zenoh.open(zenoh_config([address], [], shared_memory=shared_memory))
        inbox = Inbox(session)
        try:
            ring = inbox.ring(_KEY)
            sender.start()
            spans = _receive(inbox, ring, seconds, shared_memory)
        finally:
            inbox.close()
            session.close()
            sender.join(timeout=10.0)
    if not spans:
        transport = "shared memory" if shared_memory else "TCP"
        raise RuntimeError(f"no frame arrived through {transport} within {_CONNECT_WITHIN_S + seconds:g} s")
    return spans


def _receive(inbox: Inbox, ring: Place, seconds: float, shared: bool) -> list[tuple[float, float]]:
    """Receive as a worker does: from a ring of one, with a copy of the frame."""
    spans: list[tuple[float, float]] = []
    until = time.monotonic() + _CONNECT_WITHIN_S + seconds
    while time.monotonic() < until:
        inbox.wait(0.1)
        sample = ring.take()
        if sample is None:
            continue
        cpu = time.thread_time()
        sent_ns = int.from_bytes(sample.attachment.to_bytes(), "little") if sample.attachment else 0
        if sent_ns == 0:
            break
        by_memory = sample.payload.as_shm() is not None
        pixels = np.frombuffer(sample.payload.to_bytes(), np.uint8)
        now = time.monotonic_ns()
        del sample
        if by_memory == shared and pixels.size == FRAME_BYTES:
            spans.append(((now - sent_ns) * 1e-9, time.thread_time() - cpu))
    return spans[WARM_UP:]


def _send(address: str, shared_memory: bool, seconds: float) -> None:
    pool_bytes = _POOL_BYTES if shared_memory else 0
    session = zenoh.open(zenoh_config([], [address], shared_memory=shared_memory, pool_bytes=pool_bytes))
    frame = np.random.default_rng(0).integers(0, 255, FRAME_BYTES, dtype=np.uint8)
    publisher = session.declare_publisher(_KEY, congestion_control=zenoh.CongestionControl.DROP)
    waited_until = time.monotonic() + _CONNECT_WITHIN_S
    while not is_heard(publisher) and time.monotonic() < waited_until:
        time.sleep(0.02)
    due = time.monotonic()
    for _ in range(int(seconds * RATE_HZ)):
        sent = time.monotonic_ns().to_bytes(8, "little")
        publisher.put(frame.tobytes(), attachment=sent)
        due += 1.0 / RATE_HZ
        time.sleep(max(0.0, due - time.monotonic()))
    publisher.put(b"", attachment=bytes(8))
    time.sleep(0.2)
    session.close()
