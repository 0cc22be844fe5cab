"""A gateway with real sessions, a tracker's end of the bus, and a real certificate authority."""

import time

import msgspec
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from huepose_services.authority import Authority
from huepose_services.gateway import GatewayWork, make
from huepose_services.runtime.config import BusConfig, Config, GatewayConfig, TlsConfig
from tests.services.conftest import until
from tests.services.sessions import Working, close_bus, open_bus


class Running:
    """A tracker's end of the bus, which publishes what a test wants, and a gateway."""

    def __init__(self, base_port: int, host: str = "127.0.0.1", **gateway: object) -> None:
        self.port = base_port + 9
        self.config = Config(
            bus=BusConfig(base_port=base_port), gateway=GatewayConfig(listen=f"{host}:{self.port}", **gateway)
        )
        self.tracker = open_bus(self.config, "tracker")
        self.corrections = self.tracker.inbox.queue(self.tracker.keys.correction)
        self.gateway = self.work = None
        self.start_gateway()

    def start_gateway(self):
        self.gateway = open_bus(self.config, "gateway")
        self.work: GatewayWork = make(self.gateway, self.config)
        self._working = Working(self.gateway, self.work)

    def stop_gateway(self):
        self._working.close()

    def say(self, frame_id, **changes):
        """Publishes a pose of the example object with the current time."""
        now = time.monotonic_ns()
        clock = {"realtime_offset_ns": time.time_ns() - now}
        pose = msgspec.structs.replace(
            example(PoseMessage),
            **({"frame_id": frame_id, "capture_ns": now, "publish_ns": now} | clock | changes),
        )
        self.tracker.put(self.tracker.keys.pose(pose.object, pose.instance), pose)
        return pose

    def say_until(self, condition, timeout_s=8.0):
        """Publishes 100 poses a second until a condition holds; gives the last."""
        poses = [self.say(1001)]

        def say():
            time.sleep(0.01)
            poses.append(self.say(1001 + len(poses)))

        until(condition, timeout_s, say)
        return poses[-1]

    def close(self):
        self.stop_gateway()
        close_bus(self.tracker)


@pytest.fixture
def start(base_port):
    running = []

    def begin(**gateway):
        running.append(Running(base_port, **gateway))
        return running[-1]

    yield begin
    for one in running:
        one.close()


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    """Files of an authority, a gateway and some readers; `stranger` has another authority's certificate."""
    folder, other = (tmp_path_factory.mktemp("certificates") for _ in range(2))
    ours = Authority.make(folder, ["localhost", "127.0.0.1", "::1"], 30)
    for name in ("robot1", "robot2"):
        ours.add(name, 30)
    theirs = Authority.make(other, ["localhost"], 30)
    theirs.add("robot1", 30)
    theirs.certificate("robot1").rename(folder / "stranger.pem")
    theirs.key("robot1").rename(folder / "stranger.key")
    return folder


def tls(folder, readers=()):
    return TlsConfig(
        authority=str(folder / "authority.pem"),
        certificate=str(folder / "gateway.pem"),
        key=str(folder / "gateway.key"),
        revoked=str(folder / "revoked.pem"),
        readers=list(readers),
    )


def credentials(folder, name):
    files = {"authority": folder / "authority.pem"}
    if name is not None:
        files |= {"certificate": folder / f"{name}.pem", "key": folder / f"{name}.key"}
    return files
