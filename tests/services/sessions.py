"""Sessions and buses that tests open in place of workers and routers."""

import threading

from huepose_protos.client import configured
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.session import open_worker_session


def listening(*endpoints, mode="peer"):
    """zenoh's configuration of a session that listens there, without scouting; mode: also `router`."""
    return configured(
        {
            "mode": mode,
            "listen/endpoints": list(endpoints),
            "scouting/multicast/enabled": False,
            "timestamping/enabled": mode == "router",
        }
    )


def open_bus(config, worker) -> Bus:
    session, _ = open_worker_session(config, worker)
    return Bus(session, config.keys, worker)


def close_bus(bus):
    bus.close()
    bus.session.close()


class Working:
    """Runs a worker's steps in a thread of its own, until it is closed."""

    def __init__(self, bus, work):
        self._bus, self._work = bus, work
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop)
        self._thread.start()

    def _loop(self):
        while not self._stopping.is_set():
            self._bus.inbox.wait(0.01)
            self._work.step()

    def close(self):
        self._stopping.set()
        self._thread.join()
        self._work.close()
        close_bus(self._bus)
