"""What the tracker was given, to be had again by who records it.

Frames go to all readers at once, and one that is behind loses some. A recording must hold those that the
tracker took, or its poses cannot be computed again from there on. Each is had again for as long as the
tracker remembers it, which costs nothing: the pixels are the same; while somebody records, the newest too.
"""

from __future__ import annotations

import threading
import weakref
from collections import deque
from typing import Any

import zenoh

from huepose.geometry import RgbdFrame
from huepose_protos import WireError, decode, encode
from huepose_protos.messages import AgainRequest, FrameHeader, IntakeMessage
from huepose_services.runtime.bus import Bus

_NEWEST_BYTES = 96 * 1024 * 1024
"""Two seconds at 640 x 480 and 30 Hz, in which a busy recorder notices what it lacks."""
_STEPS = 512


class Given:
    """Answers AgainRequest, in a thread of its own that waits for readers as the worker's loop must not."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._frames: dict[tuple[int, int], tuple[FrameHeader, bytes]] = {}
        self._newest: deque[RgbdFrame] = deque()
        self._newest_bytes = 0
        self._steps: deque[IntakeMessage] = deque(maxlen=_STEPS)
        # The thread holds the channel only: a queryable that is waited on cannot be undeclared.
        queries: Any = bus.session.declare_queryable(bus.keys.again, zenoh.handlers.FifoChannel(16))
        self._queryable = queries
        threading.Thread(target=self._serve, args=(queries.handler,), daemon=True).start()

    def frame(self, header: FrameHeader, payload: bytes, frame: RgbdFrame, heard: bool) -> None:
        """One was taken; heard: somebody records."""
        key = (header.camera_epoch, header.frame_id)
        self._frames[key] = (header, payload)
        weakref.finalize(frame, self._frames.pop, key, None).atexit = False
        self._newest.append(frame)
        self._newest_bytes += len(payload)
        while self._newest and self._newest_bytes > (_NEWEST_BYTES if heard else 0):
            oldest = self._newest.popleft()
            self._newest_bytes -= len(self._frames[oldest.epoch, oldest.frame_id][1])

    def step(self, message: IntakeMessage) -> None:
        """A step was told of."""
        self._steps.append(message)

    def _serve(self, channel: Any) -> None:
        try:
            while True:
                with channel.recv() as query:
                    self._answer(query)
        except zenoh.ZError:
            return  # the session has ended

    def _answer(self, query: zenoh.Query) -> None:
        try:
            payload = query.payload
            request = decode(b"" if payload is None else payload.to_bytes(), AgainRequest)
        except WireError as error:
            self._bus.refuse(self._bus.keys.again, error)
            return
        # Whatever else is to be sent goes first.
        way: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "priority": zenoh.Priority.DATA_LOW,
        }
        steps = set(request.steps)
        for message in list(self._steps):
            if message.seq in steps:
                query.reply(self._bus.keys.again, encode(message), **way)
        for key in request.frames:
            if (found := self._frames.get(key)) is not None:
                query.reply(self._bus.keys.again, found[1], attachment=encode(found[0]), **way)
