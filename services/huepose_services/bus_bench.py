"""How long a frame takes from one process to another: shared memory beside TCP, over real sessions.

The time is from before the sender copies the frame in until the receiver holds arrays: everything that a
worker pays for a frame.
"""

from __future__ import annotations

import multiprocessing
import socket
import time

import numpy as np
import zenoh

from huepose.evaluation.benches import StageTime
from huepose_services.runtime.session import MIB, zenoh_config

_WIDTH, _HEIGHT, _RATE_HZ = 640, 480, 30.0
_KEY = "huepose/bench/frame"
_POOL_BYTES = 6 * MIB
_CONNECT_WITHIN_S = 10.0


def bench_bus(seconds: float = 6.0) -> list[StageTime]:
    """One frame of 640x480 colour and depth at 30 Hz to a ring of one: `bus/shared_memory` and `bus/tcp`.

    Raises RuntimeError when nothing arrives."""
    return [_hop("bus/shared_memory", _POOL_BYTES, seconds), _hop("bus/tcp", 0, seconds)]


def _hop(name: str, pool_bytes: int, seconds: float) -> StageTime:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    context = multiprocessing.get_context("spawn")
    sender = context.Process(target=_send, args=(endpoint, pool_bytes, seconds), daemon=True)
    session = zenoh.open(zenoh_config([endpoint], [], shared_memory=pool_bytes > 0))
    try:
        ring = session.declare_subscriber(_KEY, zenoh.handlers.RingChannel(1))
        sender.start()
        spans = _receive(ring, seconds, shared=pool_bytes > 0)
    finally:
        session.close()  # type: ignore[no-untyped-call]
        sender.join(timeout=10.0)
    if not spans:
        raise RuntimeError(f"{name}: no frame arrived within {_CONNECT_WITHIN_S + seconds:g} s")
    return StageTime.of(name, spans)


def _receive(ring: zenoh.Subscriber, seconds: float, shared: bool) -> list[tuple[float, float]]:
    """(wall, receiver's CPU) seconds of every frame that came by the asked way."""
    spans: list[tuple[float, float]] = []
    until = time.monotonic() + _CONNECT_WITHIN_S + seconds
    while time.monotonic() < until:
        sample = ring.try_recv()
        if sample is None:
            time.sleep(0.0002)
            continue
        cpu = time.thread_time()
        sent_ns = int.from_bytes(sample.attachment.to_bytes(), "little") if sample.attachment else 0
        if sent_ns == 0:
            break
        by_memory = sample.payload.as_shm() is not None
        pixels = np.frombuffer(sample.payload.to_bytes(), np.uint8)
        now = time.monotonic_ns()
        if by_memory == shared and pixels.size == _WIDTH * _HEIGHT * 5:
            spans.append(((now - sent_ns) * 1e-9, time.thread_time() - cpu))
    return spans[5:]


def _send(endpoint: str, pool_bytes: int, seconds: float) -> None:
    session = zenoh.open(zenoh_config([], [endpoint], shared_memory=pool_bytes > 0, pool_bytes=pool_bytes))
    frame = np.random.default_rng(0).integers(0, 255, _WIDTH * _HEIGHT * 5, dtype=np.uint8)
    publisher = session.declare_publisher(_KEY, congestion_control=zenoh.CongestionControl.DROP)
    waited_until = time.monotonic() + _CONNECT_WITHIN_S
    while not _has_reader(publisher) and time.monotonic() < waited_until:
        time.sleep(0.02)
    due = time.monotonic()
    for _ in range(int(seconds * _RATE_HZ)):
        sent = time.monotonic_ns().to_bytes(8, "little")
        publisher.put(frame.tobytes(), attachment=sent)
        due += 1.0 / _RATE_HZ
        time.sleep(max(0.0, due - time.monotonic()))
    publisher.put(b"", attachment=bytes(8))
    time.sleep(0.2)
    session.close()  # type: ignore[no-untyped-call]


def _has_reader(publisher: zenoh.Publisher) -> bool:
    # The stubs of zenoh 1.10 call this a bool; it is an object that holds one.
    return bool(getattr(publisher.matching_status, "matching", publisher.matching_status))
