"""A cable between a reader and a gateway that can be cut: what is sent then is held, and no end is told."""

from __future__ import annotations

import select
import socket
import threading
import time
from contextlib import suppress

_CHUNK = 65536


class Relay:
    """Listens on `port` of this machine and passes everything on to another, unless `cut`."""

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
                    data = ready.recv(_CHUNK)
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
