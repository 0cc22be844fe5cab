"""The gateway with real sessions and a real authority: who reads, who does not, and what they can do."""

import json
import re
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
import trustme
import zenoh

from huepose_protos import PoseClient, decode, encode
from huepose_protos.client import open_session
from huepose_protos.examples import messages
from huepose_protos.messages import (
    CameraMessage,
    CorrectionMessage,
    HealthMessage,
    ObjectsMessage,
    PoseMessage,
)
from huepose_services.cli.main import main
from huepose_services.gateway import GatewayWork, make
from huepose_services.pem import Credentials, why_unreachable
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.config import BusConfig, Config, GatewayConfig, TlsConfig
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.session import open_worker_session

pytestmark = pytest.mark.live
DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = {type(m): m for m in messages()}
ALL = "huepose/*/*/remote/**"


class Running:
    """A tracker's end of the bus that says what a test wants, and a gateway beside it."""

    def __init__(self, base_port: int, **gateway: object) -> None:
        self.port = base_port + 9
        self.config = Config(
            bus=BusConfig(base_port=base_port),
            gateway=GatewayConfig(listen=f"127.0.0.1:{self.port}", **gateway),
        )
        self.tracker = self._bus("tracker")
        self.corrections = self.tracker.inbox.queue(self.tracker.keys.correction)
        self.gateway = self.work = None
        self.start_gateway()

    def _bus(self, worker):
        session, _ = open_worker_session(self.config, worker)
        return Bus(session, self.config.keys, worker, Log(worker), Health(worker))

    def start_gateway(self):
        self.gateway = self._bus("gateway")
        self.work: GatewayWork = make(self.gateway, self.config)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop)
        self._thread.start()

    def _loop(self):
        while not self._stopping.is_set():
            self.gateway.inbox.wait(0.01)
            self.work.step()

    def stop_gateway(self):
        self._stopping.set()
        self._thread.join()
        self.work._outside.close()
        self.gateway.close()
        self.gateway.session.close()

    def say(self, frame_id, **changes):
        """A pose of the example object; the stamps are those of now."""
        now = time.monotonic_ns()
        clock = {"realtime_offset_ns": time.time_ns() - now}
        pose = msgspec.structs.replace(
            EXAMPLES[PoseMessage],
            **({"frame_id": frame_id, "capture_ns": now, "publish_ns": now} | clock | changes),
        )
        self.tracker.put(self.tracker.keys.pose(pose.object, pose.instance), pose)
        return pose

    def say_until(self, condition, timeout_s=8.0):
        """Poses at 100 a second until something holds; returns the last."""
        deadline, frame_id = time.monotonic() + timeout_s, 1000
        while not condition():
            assert time.monotonic() < deadline, "it did not come about in time"
            frame_id += 1
            pose = self.say(frame_id)
            time.sleep(0.01)
        return pose

    def close(self):
        self.stop_gateway()
        self.tracker.close()
        self.tracker.session.close()


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
    """Files of an authority, a gateway and some readers; one of them has another authority's certificate."""
    folder = tmp_path_factory.mktemp("certificates")
    ours, theirs = trustme.CA(organization_name="ours"), trustme.CA(organization_name="theirs")
    ours.cert_pem.write_to_path(folder / "ca.pem")
    certificates = {
        "gateway": ours.issue_cert("localhost", "127.0.0.1", common_name="gateway"),
        "robot1": ours.issue_cert("robot1.local", common_name="robot1"),
        "robot2": ours.issue_cert("robot2.local", common_name="robot2"),
        "stranger": theirs.issue_cert("robot1.local", common_name="robot1"),
    }
    for name, certificate in certificates.items():
        certificate.private_key_pem.write_to_path(folder / f"{name}.key")
        certificate.cert_chain_pems[0].write_to_path(folder / f"{name}.pem")
    return folder


def _tls(folder, readers=()):
    return TlsConfig(
        authority=str(folder / "ca.pem"),
        certificate=str(folder / "gateway.pem"),
        key=str(folder / "gateway.key"),
        readers=list(readers),
    )


def _as(folder, name):
    files = {"authority": folder / "ca.pem"}
    if name is not None:
        files |= {"certificate": folder / f"{name}.pem", "key": folder / f"{name}.key"}
    return files


def test_poses_objects_camera_and_health_are_seen_outside_and_at_once_by_who_comes_late(start):
    one = start()
    with (
        PoseClient(f"tcp/127.0.0.1:{one.port}") as first,
        PoseClient(one.config.endpoint("tracker")) as inside,
    ):
        one.say_until(lambda: first.latest() is not None and inside.latest() is not None)
    keys = one.tracker.keys
    for key, kind in (
        (keys.objects, ObjectsMessage),
        (keys.camera_info, CameraMessage),
        (keys.health("tracker"), HealthMessage),
    ):
        one.tracker.put(key, EXAMPLES[kind])
    pose = one.say(5000, state="SUSPECT")
    time.sleep(0.1)
    # From now on nobody says anything.
    session = open_session([f"tcp/127.0.0.1:{one.port}"])
    deadline, replies = time.monotonic() + 5.0, {}
    while len(replies) < 4 and time.monotonic() < deadline:
        replies = {str(r.ok.key_expr): r.ok.payload.to_bytes() for r in session.get(ALL, timeout=1.0)}
        time.sleep(0.05)
    session.close()
    assert decode(replies[keys.outside(keys.pose(pose.object, pose.instance))], PoseMessage) == pose
    assert decode(replies[keys.outside(keys.objects)], ObjectsMessage) == EXAMPLES[ObjectsMessage]
    assert decode(replies[keys.outside(keys.camera_info)], CameraMessage) == EXAMPLES[CameraMessage]
    assert decode(replies[keys.outside(keys.health("tracker"))], HealthMessage) == EXAMPLES[HealthMessage]
    with PoseClient(f"tcp/127.0.0.1:{one.port}", object=pose.object) as late:
        assert late.next(5.0) == pose


def test_a_fast_source_is_cut_to_the_rate_but_a_change_of_state_passes_at_once(start):
    one = start(max_rate_hz=10.0)
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as client:
        one.say_until(lambda: client.latest() is not None)
        time.sleep(0.15)
        while client.next(0.02) is not None:
            pass
        for i in range(100):
            one.say(5000 + i, state="SUSPECT" if i >= 50 else "TRACKING")
            time.sleep(0.004)
        time.sleep(0.2)
        got = []
        while (pose := client.next(0.1)) is not None:
            got.append(pose.frame_id)
    assert 5050 in got
    assert got[-1] == 5099, "the newest arrives, late"
    # One for each tenth of the time that it took, and two that nothing holds back.
    assert len(got) < 40


def test_what_comes_from_outside_changes_nothing(start, wait_until):
    one = start()
    correction = encode(EXAMPLES[CorrectionMessage])
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as client:
        one.say_until(lambda: client.latest() is not None)
        with open_session([f"tcp/127.0.0.1:{one.port}"]) as other:
            wait_until(lambda: list(other.info.peers_zid()))
            keys = one.tracker.keys
            forged = encode(msgspec.structs.replace(EXAMPLES[PoseMessage], frame_id=666_666))
            for _ in range(20):
                for key in (keys.correction, keys.outside(keys.correction)):
                    other.put(key, correction)
                for key in (keys.pose("forged", 0), keys.outside(keys.pose("forged", 0))):
                    other.put(key, forged)
                time.sleep(0.005)
        # The way inside is open for the tracker's own neighbours, so the silence above is not an accident.
        assert one.tracker.take(one.corrections, CorrectionMessage) is None
        one.gateway.put_control(keys.correction, EXAMPLES[CorrectionMessage])
        wait_until(lambda: one.tracker.take(one.corrections, CorrectionMessage) is not None)
        assert client.latest().frame_id != 666_666
        assert client.latest("forged") is None


def test_garbage_inside_is_not_passed_on(start, wait_until):
    one = start()
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as client:
        one.say_until(lambda: client.latest() is not None)
        for data in (b"", b"\xc1", encode(EXAMPLES[PoseMessage])[:-3], b"\xff" * 9000):
            one.tracker.session.put(one.tracker.keys.pose("garbage", 0), data)
        frame = one.say(9000, state="SUSPECT").frame_id
        while client.next(5.0).frame_id != frame:
            pass
        assert client.refused == 0
    assert one.gateway.health.counters["wire_errors"] == 4


def test_only_the_authoritys_certificates_read(start, authority):
    one = start(tls=_tls(authority))
    clients = {
        name: PoseClient(f"tls/localhost:{one.port}", **_as(authority, name))
        for name in ("robot1", "robot2", "stranger", None)
    }
    clients["no TLS"] = PoseClient(f"tcp/localhost:{one.port}")
    one.say_until(lambda: clients["robot1"].latest() and clients["robot2"].latest())
    # As long again for the others.
    for i in range(60):
        one.say(7000 + i)
        time.sleep(0.01)
    heard = {name for name, client in clients.items() if client.latest() is not None}
    for client in clients.values():
        client.close()
    assert heard == {"robot1", "robot2"}


def test_only_listed_names_read_and_a_reader_cannot_steer(start, authority):
    one = start(tls=_tls(authority, ["robot1"]))
    address = f"tls/localhost:{one.port}"
    listed = PoseClient(address, **_as(authority, "robot1"))
    unlisted = PoseClient(address, **_as(authority, "robot2"))
    steering = open_session([address], **_as(authority, "robot1"))
    one.say_until(lambda: listed.latest() is not None and unlisted.connected)
    for _ in range(30):
        steering.put(one.tracker.keys.correction, encode(EXAMPLES[CorrectionMessage]))
        one.say(7000)
        time.sleep(0.01)
    for reply in steering.get(one.tracker.keys.control, timeout=0.5):
        pytest.fail(f"control answered: {reply}")
    assert unlisted.latest() is None
    assert one.tracker.take(one.corrections, CorrectionMessage) is None
    for client in (listed, unlisted, steering):
        client.close()


def test_poses_are_printed_on_another_machine_the_latest_at_once(start, authority, huepose):
    one = start(tls=_tls(authority, ["robot1"]))
    address, files = f"localhost:{one.port}", _as(authority, "robot1")
    with PoseClient(f"tls/{address}", **files) as client:
        last = one.say_until(lambda: client.latest() is not None)
    # From now on nobody says anything.
    printer = huepose("poses", "--json", "--gateway", address, "--tls", *files.values())
    assert json.loads(printer.stdout.readline())["frame_id"] == last.frame_id
    one.stop_gateway()
    assert "is gone; waiting for it" in printer.stderr.readline()
    one.start_gateway()
    time.sleep(0.5)
    lines: list[str] = []
    reader = threading.Thread(target=lambda: lines.append(printer.stdout.readline()))
    reader.start()
    one.say_until(lambda: lines)
    reader.join()
    assert json.loads(lines[0])["object"] == last.object
    printer.terminate()
    assert printer.wait(5.0) == 0


def test_why_a_gateway_is_not_reached_is_said(start, authority, base_port, monkeypatch):
    monkeypatch.setattr("huepose_services.pem._WITHIN_S", 0.5)
    one = start(tls=_tls(authority))
    shown = {name: Credentials(*_as(authority, name).values()) for name in ("robot1", "stranger")}
    shown["no authority"] = replace(shown["robot1"], authority=authority / "robot2.pem")
    reasons = {name: why_unreachable("localhost", one.port, files) for name, files in shown.items()}
    assert reasons["robot1"] is None
    assert "does not accept this certificate" in reasons["stranger"]
    assert "its certificate is not accepted" in reasons["no authority"]
    assert "give --tls" in why_unreachable("localhost", one.port, None)
    assert why_unreachable("localhost", base_port + 8, None) == "no program listens there"
    assert "no TLS there" in why_unreachable("127.0.0.1", base_port + 1, shown["robot1"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--gateway", "a b"], "expected HOST or HOST:PORT"),
        (["--tls", "{0}/ca.pem", "{0}/robot1.pem", "{0}/robot1.key"], "no --gateway"),
        (["--gateway", "x", "--tls", "{0}/ca.pem", "{0}/robot1.pem", "{0}/nothing"], "--tls key"),
        (["--gateway", "x", "--tls", "{0}/ca.pem", "{0}/robot1.pem", "{0}/robot2.key"], "key that belongs"),
    ],
)
def test_options_for_another_machine_that_cannot_work_are_refused(authority, capsys, options, said):
    assert main(["poses", *(option.format(authority) for option in options)]) == 2
    assert said in capsys.readouterr().err


def test_a_client_that_is_there_first_survives_a_gateway_that_comes_and_goes(base_port):
    with PoseClient(f"tcp/127.0.0.1:{base_port + 9}") as client:
        assert client.next(0.2) is None
        assert not client.connected
        assert client.silent_s() == float("inf")
        one = Running(base_port)
        one.say_until(lambda: client.latest() is not None)
        now = client.at()
        assert now.ahead_s < 0.1
        assert client.at(time.time_ns() + 10**9) is None
        one.stop_gateway()
        time.sleep(0.3)
        assert not client.connected
        assert client.latest(max_age_s=0.2) is None
        assert client.silent_s() > 0.2
        one.start_gateway()
        time.sleep(0.1)
        last = one.say_until(lambda: client.silent_s() < 0.1)
        assert client.connected
        assert last.frame_id > 1000
        one.close()


def test_the_twenty_lines_of_the_manual_print_poses(start):
    page = (DOCS / "subscribers.md").read_text()
    code = re.search(r"## Without our package.*?```python\n(.*?)```", page, re.DOTALL)[1]
    lines = [line for line in code.splitlines() if line.strip()]
    assert len(lines) <= 22
    assert not {"huepose_protos", "msgspec"} & set(re.findall(r"import (\w+)", code))
    one = start()
    process = subprocess.Popen(
        [sys.executable, "-c", code, f"tcp/127.0.0.1:{one.port}"], stdout=subprocess.PIPE, text=True
    )
    got = []
    reader = threading.Thread(target=lambda: got.append(process.stdout.readline()))
    reader.start()
    pose = one.say_until(lambda: got)
    process.kill()
    reader.join()
    process.communicate()
    place = json.loads(json.dumps(pose.translation))
    assert got[0].startswith(f"{pose.object} {pose.instance} TRACKING {place} ")


@pytest.mark.parametrize("name", ["authority", "certificate", "key"])
def test_files_that_are_not_there_are_named(base_port, authority, name):
    from huepose.support.errors import InputError
    from huepose_services.gateway_session import open_outside

    tls = msgspec.structs.replace(_tls(authority), **{name: str(authority / "nothing.pem")})
    with pytest.raises(InputError, match=f"gateway.tls.{name}.*No such file"):
        open_outside(GatewayConfig(listen=f"127.0.0.1:{base_port}", tls=tls))


def test_an_open_port_without_tls_is_warned_of(base_port):
    from huepose_services.gateway_session import open_outside

    session, warnings = open_outside(GatewayConfig(listen=f"0.0.0.0:{base_port}"))
    session.close()
    assert "anyone who reaches" in warnings[0]
    assert isinstance(session, zenoh.Session)


def test_the_worker_processes_of_a_camera_and_a_gateway(pipeline, huepose, base_port, wait_until):
    path = pipeline(once=False, rate=20)
    given = json.loads(path.read_text())
    listen = f"127.0.0.1:{base_port + 9}"
    path.write_text(json.dumps(given | {"workers": ["camera", "gateway"], "gateway": {"listen": listen}}))
    workers = [huepose("run", name, path) for name in ("camera", "gateway")]
    session, replies = open_session([f"tcp/{listen}"]), {}

    def both_heard():
        replies.update({str(r.ok.key_expr): r.ok.payload.to_bytes() for r in session.get(ALL, timeout=0.5)})
        return {f"huepose/local/cam0/remote/{tail}" for tail in ("camera", "health/camera")} <= set(replies)

    wait_until(both_heard, 60.0)
    session.close()
    camera = decode(replies["huepose/local/cam0/remote/camera"], CameraMessage)
    assert (camera.intrinsics.width, camera.intrinsics.height, camera.intrinsics.fx) == (64, 48, 60.0)
    for worker in workers:
        worker.terminate()
        assert worker.wait(5.0) == 0
