"""The gateway with real sessions: what can be read outside, and that nothing comes in."""

import json
import re
import threading
import time

import msgspec
import pytest

from huepose_protos import PoseClient, decode, encode
from huepose_protos.client import open_session
from huepose_protos.examples import example
from huepose_protos.messages import (
    CameraMessage,
    CorrectionMessage,
    HealthMessage,
    ObjectEntry,
    ObjectsMessage,
    PoseMessage,
)
from huepose_services.gateway import _Said, answer_of
from tests.services.conftest import until

from .conftest import Running, credentials, tls

pytestmark = pytest.mark.live
ALL = "huepose/*/*/remote/**"


def test_poses_objects_camera_and_health_can_be_read_outside_also_by_late_clients(start):
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
        one.tracker.put(key, example(kind))
    pose = one.say(5000, state="SUSPECT")
    # From now on nothing is published.
    session = open_session([f"tcp/127.0.0.1:{one.port}"])
    its_key, replies = keys.outside(keys.pose(pose.object, pose.instance)), {}

    def answered():
        replies.update({str(r.ok.key_expr): r.ok.payload.to_bytes() for r in session.get(ALL, timeout=1.0)})
        return len(replies) == 4 and decode(replies[its_key], PoseMessage) == pose

    until(answered, 5.0)
    session.close()
    assert decode(replies[keys.outside(keys.objects)], ObjectsMessage) == example(ObjectsMessage)
    assert decode(replies[keys.outside(keys.camera_info)], CameraMessage) == example(CameraMessage)
    assert decode(replies[keys.outside(keys.health("tracker"))], HealthMessage) == example(HealthMessage)
    with PoseClient(f"tcp/127.0.0.1:{one.port}", object=pose.object) as late:
        assert late.next(5.0) == pose


def test_after_the_tracker_died_its_last_pose_is_answered_as_suspect(start):
    one = start()
    address = f"tcp/127.0.0.1:{one.port}"
    with PoseClient(address) as before:
        last = one.say_until(lambda: before.latest() is not None)
    time.sleep(1.5e-3 * one.config.tracker.max_age_ms)
    with PoseClient(address) as late:
        answer = late.next(5.0)
        assert answer.publish_ns > last.publish_ns
        said = {
            "state": "SUSPECT",
            "reason": "Nothing was published about it for a while: the tracker has ended, or hangs.",
        }
        assert answer == msgspec.structs.replace(last, publish_ns=answer.publish_ns, **said)
        died_s, silent_s = 1e-9 * (time.monotonic_ns() - last.capture_ns), late.silent_s()
        assert died_s - 0.05 < silent_s < 1e-9 * (time.monotonic_ns() - last.capture_ns) + 0.05
        assert late.latest(max_age_s=0.9 * died_s) is None
        assert one.say(9000, state="TRACKING") == late.next(5.0)
        assert late.silent_s() < 0.9 * died_s


@pytest.mark.parametrize("removed", [True, False])
def test_a_late_client_gets_no_pose_of_a_removed_object_or_retired_instance(start, removed):
    one = start()
    address, keys = f"tcp/127.0.0.1:{one.port}", one.tracker.keys
    with PoseClient(address) as before:
        last = one.say_until(lambda: before.latest() is not None)
    entry = ObjectEntry(
        object="another" if removed else last.object,
        max_instances=1,
        searching=1,
        retired=None if removed else (last.camera_epoch, last.instance + 1),
    )
    one.tracker.put(keys.objects, ObjectsMessage(publish_ns=1, objects=[entry]))
    with PoseClient(address) as late:
        until(lambda: late.looked_for() == [entry.object])
    with PoseClient(address) as late:
        assert late.next(1.0) is None
        new = one.say(9000, instance=last.instance + 1)
        assert late.next(1.0 if removed else 5.0) == (None if removed else new)


def test_a_pose_is_answered_unchanged_until_it_is_too_old():
    for state, age_ns, answered in (
        ("TRACKING", 5, "TRACKING"),
        ("TRACKING", 6, "SUSPECT"),
        ("LOST", 6, "LOST"),
    ):
        nowhere = dict.fromkeys(("translation", "quaternion")) if state == "LOST" else {}
        pose = msgspec.structs.replace(example(PoseMessage), state=state, **nowhere)
        said = _Said(encode(pose), pose, 1000)
        assert decode(answer_of(said, 1000 + age_ns, 5), PoseMessage).state == answered


def test_the_rate_is_limited_but_a_change_of_state_passes_at_once(start):
    one = start(max_rate_hz=10.0)
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as client:
        one.say_until(lambda: client.latest() is not None)
        began = time.monotonic()
        for i in range(100):
            one.say(5000 + i, state="SUSPECT" if i >= 50 else "TRACKING")
            time.sleep(0.004)
        got = [0]
        while got[-1] != 5099:
            pose = client.next(5.0)
            assert pose is not None, "the newest arrives, late"
            got.append(pose.frame_id)
        took_s = time.monotonic() - began
    assert 5050 in got
    # One for each tenth of a second that it took, and two that are not held back.
    assert sum(number >= 5000 for number in got) <= 10.0 * took_s + 4.0


def test_a_subscriber_keeps_the_newest_pose_of_each_frame(start):
    """As when the camera stops: the last pose is published again, as SUSPECT. Repeated and older messages are
    not given again."""
    one = start()
    with PoseClient(one.config.endpoint("tracker")) as client:
        one.say_until(lambda: client.latest() is not None)
        before, sure = one.say(5000), one.say(5001, state="TRACKING")
        later = {"capture_ns": sure.capture_ns, "state": "SUSPECT", "reason": "No new frame came."}
        doubted = one.say(5001, **later)
        one.say(5001, **later)
        one.say(5001, capture_ns=sure.capture_ns, publish_ns=sure.publish_ns, state="TRACKING")
        one.say(5000, capture_ns=before.capture_ns, state="SUSPECT")
        applied = doubted.applied_correction_seq + 1
        corrected = one.say(5001, **later, applied_correction_seq=applied)
        last = one.say(5002, state="SUSPECT")
        heard = []
        while (pose := client.next(2.0)) != last:
            assert pose is not None
            heard.append(pose)
        kept = [p for (poses,) in [client._history.values()] for p in poses if p.frame_id >= 5000]
        between = client.at(sure.capture_ns + sure.realtime_offset_ns)
    assert heard[-4:] == [before, sure, doubted, corrected]
    assert kept == [before, corrected, last]
    assert between.state == "SUSPECT"


@pytest.mark.parametrize(
    ("listens", "hosts"),
    [("[::1]", ["[::1]"]), ("[::]", ["[::1]", "127.0.0.1"]), ("localhost", ["127.0.0.1", "localhost"])],
)
def test_the_gateway_also_listens_at_ipv6_addresses(start, listens, hosts):
    one = start(host=listens)
    for host in hosts:
        with PoseClient(f"tcp/{host}:{one.port}") as client:
            one.say_until(lambda reader=client: reader.latest() is not None)
    assert bool(one.gateway.health.message().warnings) == (listens == "[::]"), (
        "a warning that others can read it"
    )


def test_over_tls_the_client_asks_for_a_name_instead_of_an_ipv6_address(start, authority):
    one = start(host="[::]", tls=tls(authority))
    files = credentials(authority, "robot1")
    with PoseClient(f"tls/[::1]:{one.port}", **files) as client:
        assert client.why_silent() == (
            f"waiting for a gateway at tls/[::1]:{one.port}: zenoh cannot connect to an IPv6 address by TLS: "
            "give the gateway's name instead"
        )
    with PoseClient(f"tls/localhost:{one.port}", **files) as client:
        one.say_until(lambda: client.latest() is not None)
        assert re.fullmatch(r"connected: the last pose came \d\.\d s ago", client.why_silent())


def test_a_new_client_does_not_report_that_nothing_comes(start):
    one = start()
    with PoseClient(f"localhost:{one.port}") as client:
        last = one.say_until(lambda: client.latest() is not None)
    for _ in range(3):
        with PoseClient(f"localhost:{one.port}") as client:
            said = re.fullmatch(r"connected: the last pose came (\d+\.\d) s ago", client.why_silent())
        assert float(said[1]) < 1e-9 * (time.monotonic_ns() - last.capture_ns) + 0.1


def test_a_tracker_that_starts_is_distinguished_from_objects_out_of_view(start, wait_until):
    one = start()
    with PoseClient(f"localhost:{one.port}") as client:
        wait_until(lambda: client.connected)
        assert "no tracker answers, or it is still starting" in client.why_silent()
        names = [entry.object for entry in example(ObjectsMessage).objects]
        one.tracker.put(one.tracker.keys.objects, example(ObjectsMessage))
        wait_until(lambda: client.looked_for() == sorted(names))
        listed = ", ".join(sorted(names))
        said = f"connected, but none of the objects that are searched for ({listed}) is seen: "
        assert client.why_silent() == said + "`huepose status` says why"


def test_an_ipv6_address_without_a_gateway_is_reported(base_port):
    with PoseClient(f"[::1]:{base_port}") as client:
        assert client.why_silent().endswith(f"tcp/[::1]:{base_port}: no program listens there")


def test_messages_from_outside_change_nothing(start, wait_until):
    one = start()
    correction = encode(example(CorrectionMessage))
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as client:
        one.say_until(lambda: client.latest() is not None)
        with open_session([f"tcp/127.0.0.1:{one.port}"]) as other:
            wait_until(lambda: list(other.info.peers_zid()))
            keys = one.tracker.keys
            forged = encode(msgspec.structs.replace(example(PoseMessage), frame_id=666_666))
            for _ in range(20):
                for key in (keys.correction, keys.outside(keys.correction)):
                    other.put(key, correction)
                for key in (keys.pose("forged", 0), keys.outside(keys.pose("forged", 0))):
                    other.put(key, forged)
                time.sleep(0.005)
        # Workers inside reach the tracker, so it is no accident that nothing arrived from outside.
        assert one.tracker.take(one.corrections, CorrectionMessage) is None
        one.gateway.put_control(keys.correction, example(CorrectionMessage))
        wait_until(lambda: one.tracker.take(one.corrections, CorrectionMessage) is not None)
        assert client.latest().frame_id != 666_666
        assert client.latest("forged") is None


def test_garbage_inside_is_not_passed_on(start, wait_until):
    one = start()
    with PoseClient(f"tcp/127.0.0.1:{one.port}") as client:
        one.say_until(lambda: client.latest() is not None)
        for data in (b"", b"\xc1", encode(example(PoseMessage))[:-3], b"\xff" * 9000):
            one.tracker.session.put(one.tracker.keys.pose("garbage", 0), data)
        frame = one.say(9000, state="SUSPECT").frame_id
        while client.next(5.0).frame_id != frame:
            pass
        assert client.refused == 0
    # Messages of another priority than poses may arrive after them.
    wait_until(lambda: one.gateway.health.counters["wire_errors"] == 4)


def test_poses_are_printed_on_another_machine_the_latest_at_once(start, authority, huepose):
    one = start(tls=tls(authority, ["robot1"]))
    address, files = f"localhost:{one.port}", credentials(authority, "robot1")
    with PoseClient(f"tls/{address}", **files) as client:
        last = one.say_until(lambda: client.latest() is not None)
    # From now on nothing is published.
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


@pytest.mark.parametrize("wanted", ["pose/**", "mustard"])
def test_the_command_says_why_no_pose_comes_while_the_pipeline_runs(start, huepose, wanted):
    """Also for one object, while the list of objects comes."""
    one, listed = start(), threading.Event()
    entry = ObjectEntry(object="mustard", max_instances=1, searching=1)

    def tell() -> None:
        while not listed.wait(0.1):
            one.tracker.put(one.tracker.keys.objects, ObjectsMessage(publish_ns=1, objects=[entry]))

    teller = threading.Thread(target=tell)
    teller.start()
    try:
        said = huepose("poses", wanted, "--gateway", f"127.0.0.1:{one.port}").stderr.readline()
    finally:
        listed.set()
        teller.join()
    assert "no object is seen, or a worker is missing there; `huepose status` there says which" in said


def test_a_client_survives_a_gateway_that_starts_later_and_restarts(base_port):
    with PoseClient(f"tcp/127.0.0.1:{base_port + 9}") as client:
        assert client.next(0.2) is None
        assert not client.connected
        assert client.silent_s() == float("inf")
        one = Running(base_port)
        found = []
        one.say_until(lambda: found.append(client.at()) or found[-1])
        assert found[-1].ahead_s < 0.1
        assert client.at(time.time_ns() + 10**9) is None
        one.stop_gateway()
        until(lambda: not client.connected and client.silent_s() > 0.2)
        assert client.latest(max_age_s=0.2) is None
        one.start_gateway()
        last = one.say_until(lambda: client.silent_s() < 0.1)
        assert client.connected
        assert last.frame_id > 1000
        one.close()


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
