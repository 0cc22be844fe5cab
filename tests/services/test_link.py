"""A pipeline on two computers: which part runs where, what is sent between them, and what is not."""

import socket
import time
from types import SimpleNamespace

import msgspec
import pytest

from huepose.support.errors import InputError
from huepose_protos import encode
from huepose_protos.buffers import pack
from huepose_protos.client import open_session
from huepose_protos.examples import example, images
from huepose_protos.messages import (
    CorrectionMessage,
    Detections,
    Estimates,
    FrameHeader,
    HealthMessage,
    Look,
    Masks,
    PerceptionRequest,
)
from huepose_services import downlink, uplink
from huepose_services.authority import Authority
from huepose_services.camera.audience import Audience
from huepose_services.cli.graph import as_json, mermaid
from huepose_services.cli.units import units
from huepose_services.runtime.config import BusConfig, Config, LinkConfig
from huepose_services.runtime.prepare import check_ports
from huepose_services.runtime.running import described
from huepose_services.watch import View
from tests.services.conftest import parse, until
from tests.services.sessions import Working, close_bus, open_bus

_, PIXELS = pack(images())
HOUR_NS = 3600 * 10**9
ALL = ("detector", "segmenter", "estimator")


def over_two(far=ALL, **more):
    return Config(hosts={"desk": far}, link=LinkConfig(connect="localhost:7448"), **more)


def test_each_computer_has_its_part():
    config = over_two()
    robot, desk = config.at(None), config.at("desk")
    assert robot.workers == ("camera", "tracker", "reinit", "uplink")
    assert desk.workers == (*ALL, "downlink")
    assert (robot.host, desk.host) == (None, "desk")
    assert [config.beside(w) for w in ("reinit", "uplink")] == [robot, robot]
    assert [config.beside(w) for w in ("estimator", "downlink")] == [desk, desk]
    with pytest.raises(InputError, match="--host: found roof; expected one of: desk"):
        config.at("roof")
    assert Config().at(None) == Config()


def test_a_port_of_the_link_in_use_is_refused_before_a_worker_starts(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    Authority.make(tmp_path / "secure", ["localhost"], 30)
    with socket.create_server(("127.0.0.1", 0)) as other:
        listen = f"127.0.0.1:{other.getsockname()[1]}"
        link = LinkConfig(listen=listen, connect=listen, secure=str(tmp_path / "secure"))
        config = Config(hosts={"desk": ALL}, link=link)
        check_ports(config.at("desk"))
        with pytest.raises(InputError, match=f"link.listen {listen}: found Address already in use"):
            check_ports(config.at(None))
    check_ports(config.at(None))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("hosts: {desk: [detector]}", "expected detector, segmenter, estimator or segmenter, estimator"),
        ("hosts: {desk: [segmenter, detector, estimator]}", "hosts.desk"),
        ("hosts: {desk: []}", "hosts.desk: found none"),
        ("hosts: {desk: [tracker]}", "hosts"),
        ("hosts: {a: [estimator], b: [segmenter]}", "hosts"),
        ("hosts: {desk: [estimator]}", "link.connect: found null"),
        (
            "{hosts: {desk: [estimator]}, link: {connect: '[fd00::2]:7448'}}",
            r"link.connect: found \[fd00::2\]:7448; expected a name",
        ),
        ("workers: [camera, uplink]", "workers: found uplink"),
    ],
)
def test_impossible_hosts_and_links_are_refused(tmp_path, text, part):
    with pytest.raises(InputError, match=".*".join(part.split(" ... "))) as error:
        parse(text, tmp_path / "pipeline.yaml")
    assert "pipeline.yaml" in str(error.value)


def test_a_recording_waits_for_the_workers_of_both_computers():
    inbox = SimpleNamespace(liveliness=lambda key: None)
    audience = Audience(SimpleNamespace(inbox=inbox), over_two().at(None))
    assert audience.missing == {"tracker", "reinit", "uplink", *ALL}


def test_units_and_graph_are_those_of_a_computer(tmp_path):
    config = over_two()
    files = units([config.at("desk")], tmp_path / "huepose", tmp_path / "p.yaml", "huepose")
    assert "IPAddressDeny=\n" in files["huepose@downlink.service.d/needs.conf"]
    assert "huepose@camera.service" not in files["huepose.target"]
    pipeline = described(config.at(None), tmp_path / "p.yaml")
    graph = mermaid(View(pipeline, False, {}, frozenset(), (), [], {}))
    there = graph[graph.index("subgraph desk") : graph.index("    end")]
    assert all(f'{worker}["' in there for worker in (*ALL, "downlink"))
    assert 'reinit -- "request + frame" --> uplink\n    uplink == TLS ==> downlink' in graph
    assert "camera -- frame --> detector" not in graph
    answer = as_json(View(pipeline, False, {}, frozenset(), (), [], {}))
    assert {w["worker"] for w in answer["workers"] if w["host"] == "desk"} == {*ALL, "downlink"}
    assert {"from": "reinit", "to": "detector", "what": "request + frame", "rate_hz": None} in answer["edges"]
    assert ("camera", "detector") not in {(edge["from"], edge["to"]) for edge in answer["edges"]}
    assert described(config.at("desk"), tmp_path / "p.yaml").workers == (*ALL, "downlink")


class Side:
    """One end of the link with its bus, and the bus of another worker on the same computer."""

    def __init__(self, config, link, other):
        self.config = config
        self.bus, self.other = open_bus(config, link), open_bus(config, other)
        self.work = (uplink if link == "uplink" else downlink).make(self.bus, config)
        self._working = Working(self.bus, self.work)

    def close(self):
        self._working.close()
        close_bus(self.other)


@pytest.fixture
def folder(tmp_path):
    ours = Authority.make(tmp_path / "ours", ["localhost"], 30)
    for name in ("desk", "reader"):
        ours.add(name, 30)
    return ours.folder


@pytest.fixture
def sides(base_port, folder):
    """A function of the workers at the desk: makes both ends."""
    opened = []

    def make(far=ALL):
        link = LinkConfig(
            listen=f"127.0.0.1:{base_port + 9}", connect=f"localhost:{base_port + 9}", secure=str(folder)
        )
        robot, desk = (
            Config(hosts={"desk": far}, link=link, bus=BusConfig(base_port=base_port + more))
            for more in (0, 20)
        )
        opened.append(Side(robot.at(None), "uplink", "reinit"))
        opened.append(Side(desk.at("desk"), "downlink", "estimator"))
        return opened

    yield make
    for one in opened:
        one.close()


def _frame(capture_ns):
    return msgspec.structs.replace(example(FrameHeader), publish_ns=capture_ns, capture_ns=capture_ns)


@pytest.mark.live
def test_a_request_takes_its_frame_along_and_the_answer_has_its_stamp(sides):
    robot, desk = sides()
    looks = desk.other.inbox.ring(desk.other.keys.look)
    answers = robot.other.inbox.queue(robot.other.keys.estimates)
    now = time.monotonic_ns()
    request = msgspec.structs.replace(example(PerceptionRequest), publish_ns=now, deadline_ns=now + 10**9)
    frame = _frame(now)

    def crossed():
        robot.other.put_pixels(robot.other.keys.frame, frame, PIXELS)
        robot.other.put_control(robot.other.keys.request, request)
        time.sleep(0.05)
        return desk.other.take_with_payload(looks, Look)

    look, pixels = until(crossed)
    assert (look.request, look.frame, pixels) == (request, frame, PIXELS)

    def answer(**changes):
        header = {"camera_epoch": frame.camera_epoch, "frame_id": frame.frame_id, "capture_ns": now}
        said = msgspec.structs.replace(example(Estimates), **header | {"publish_ns": now + HOUR_NS} | changes)
        # The desk's clock may be hours off: only its own bus would refuse that.
        desk.work._outside.put(desk.bus.keys.down(desk.bus.keys.estimates), encode(said))

    answer(frame_id=frame.frame_id + 1)  # of a frame that was never sent
    answer(capture_ns=now + 1)
    answer(request_seq=99)
    got = until(lambda: robot.other.take(answers, Estimates))
    assert (got.request_seq, got.capture_ns) == (99, now)
    assert abs(got.publish_ns - time.monotonic_ns()) < 10**10
    assert robot.bus.health.counters["answers_about_frames_not_sent"] == 2


@pytest.mark.live
def test_a_frame_that_was_answered_in_full_is_not_sent_again_and_the_next_one_is(sides):
    robot, desk = sides()
    looks = desk.other.inbox.queue(desk.other.keys.look)
    now = time.monotonic_ns()
    request = msgspec.structs.replace(example(PerceptionRequest), publish_ns=now, deadline_ns=now + 10**10)
    frame = _frame(now)

    def crossed(frame=frame, request=request):
        robot.other.put_pixels(robot.other.keys.frame, frame, PIXELS)
        if request is not None:
            robot.other.put_control(robot.other.keys.request, request)
        time.sleep(0.05)
        return desk.other.take_with_payload(looks, Look)

    until(crossed)
    time.sleep(0.3)
    while desk.other.take_with_payload(looks, Look) is not None:
        pass
    seen = msgspec.structs.replace(request, seen=(frame.camera_epoch, frame.frame_id))
    assert [crossed(request=seen) for _ in range(5)] == [None] * 5
    newer = msgspec.structs.replace(frame, frame_id=frame.frame_id + 1)
    look, _ = until(lambda: crossed(newer, None))
    assert (look.request, look.frame.frame_id) == (seen, newer.frame_id)


@pytest.mark.live
@pytest.mark.parametrize(("far", "kind"), [(ALL[1:], Detections), (ALL[2:], Masks)])
def test_only_the_last_workers_of_perception_may_run_there(sides, far, kind):
    robot, desk = sides(far)
    key = robot.bus.keys.detections if kind is Detections else robot.bus.keys.masks
    found = desk.other.inbox.ring(key)
    now = time.monotonic_ns()
    said = msgspec.structs.replace(example(kind), publish_ns=now, frame=_frame(now))

    def crossed():
        robot.other.put_pixels(key, said, PIXELS)
        time.sleep(0.05)
        return desk.other.take_with_payload(found, kind)

    got, pixels = until(crossed)
    assert (got.frame, got.objects, pixels) == (said.frame, said.objects, PIXELS)


@pytest.mark.live
def test_who_is_there_is_seen_and_nobody_else_comes_or_steers(sides, folder):
    robot, desk = sides()
    keys = robot.bus.keys
    health = robot.other.inbox.queue(keys.health())
    corrections = robot.other.inbox.queue(keys.correction)
    heard = set()

    def seen():
        for worker in ("estimator", "tracker"):  # the second one is not of the desk
            said = msgspec.structs.replace(example(HealthMessage), worker=worker)
            desk.other.put(keys.health(worker), msgspec.structs.replace(said, publish_ns=time.monotonic_ns()))
        desk.bus.say_health()
        while (message := robot.other.take(health, HealthMessage)) is not None:
            heard.add(message.worker)
        time.sleep(0.05)
        return {"estimator", "downlink"} <= heard

    until(seen)
    assert "tracker" not in heard
    assert not robot.bus.health.message().warnings
    # Messages of the desk under other keys are dropped; another certificate of the authority is refused.
    where = f"tls/{robot.config.link.connect}"
    bytes_of = encode(example(CorrectionMessage))
    stranger = open_session([where], folder / "authority.pem", folder / "reader.pem", folder / "reader.key")
    for session in (desk.work._outside, stranger):
        for key in (keys.correction, keys.down(keys.correction), keys.up(keys.objects)):
            session.put(key, bytes_of)
    until(lambda: robot.work._door.refused > 0)
    time.sleep(0.3)
    assert robot.other.take(corrections, CorrectionMessage) is None
    assert not stranger.info.peers_zid()
    stranger.close()
    # After 2.5 s without a message there is a warning, and its workers no longer count as running.
    until(lambda: "desk has sent nothing" in str(robot.bus.health.message().warnings), 5.0)
    assert robot.bus.health.state == "waiting"
    assert not robot.work._tokens
