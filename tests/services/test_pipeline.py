"""All six workers as processes: an object in a recording is found and tracked, whatever is sent to them."""

import json
import os
import signal
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from huepose.evaluation.metrics import add
from huepose_protos.keys import Keys
from huepose_protos.messages import ControlRequest
from huepose_services.chaos.intruder import flood
from huepose_services.cli.graph import as_json, mermaid
from huepose_services.cli.objects import ask
from huepose_services.cli.status import as_text
from huepose_services.convert import pose_from_wire
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.running import pick
from huepose_services.watch import Watch
from tests.services.conftest import NAME, PLAYED, patient_pipeline, processes

pytestmark = [pytest.mark.live, pytest.mark.pipeline, pytest.mark.timeout(240)]


@dataclass
class Running:
    """The pipeline, a watch on it, and functions to control it."""

    path: Path
    watch: Watch
    start: Any
    supervisor: Any

    def instances(self):
        """Numbers of the object's instances that have a pose now."""
        self.watch.look(0.1)
        return {k[1] for k, p in self.watch.view().poses.items() if p.state in ("TRACKING", "SUSPECT")}

    def order(self, action, name=None, **more):
        """The pipeline's reply to a request about its list of objects."""
        request = ControlRequest(publish_ns=now_ns(), action=action, object=name, **more)
        return ask(self.watch.pipeline, request)


@pytest.fixture(scope="module")
def running(recording, tmp_path_factory):
    """One pipeline for all tests here, in their order; it repeats the recording."""
    folder, _, _ = recording
    path = tmp_path_factory.mktemp("running") / "pipeline.yaml"
    path.write_text(json.dumps(patient_pipeline(folder / "bundles", folder / "scene")))
    with processes() as start, Watch(pick(path)) as watch:
        yield Running(path, watch, start, start("up", path))


def test_an_object_is_found_and_has_a_right_pose_in_nearly_every_frame(running, recording, wait_until):
    _, mesh, truths = recording
    printer, poses = running.start("poses", "--json", "--config", running.path), []

    def read():
        poses.extend(map(json.loads, printer.stdout))

    reader = threading.Thread(target=read)
    reader.start()
    wait_until(lambda: len(poses) > PLAYED + 10, 120.0)
    printer.send_signal(signal.SIGTERM)
    reader.join()
    assert printer.wait(10.0) == 0
    frames = [p["frame_id"] for p in poses]
    assert frames == sorted(frames)
    with_pose = {p["frame_id"]: p for p in poses if p["translation"] is not None}
    first, last = min(with_pose), max(frames)
    assert len(with_pose) >= 0.95 * (last - first + 1)
    assert {(p["object"], p["instance"]) for p in poses} == {(NAME, poses[0]["instance"])}
    errors = [
        add(mesh.vertices, pose_from_wire(p["translation"], p["quaternion"]), truths[i % PLAYED].T_cam_obj)
        for i, p in with_pose.items()
    ]
    assert np.mean(np.array(errors) < 0.017) > 0.95
    assert all(p["capture_ns"] < p["publish_ns"] for p in poses)


def _listening(pid):
    """The addresses that a process listens on by TCP, or has bound by UDP."""
    mine, out = set(), set()
    for name in os.listdir(f"/proc/{pid}/fd"):
        with suppress(FileNotFoundError):  # closed meanwhile
            link = os.readlink(f"/proc/{pid}/fd/{name}")
            mine |= {link[8:-1]} if link.startswith("socket:[") else set()
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        path = Path(f"/proc/{pid}/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else []:
            fields = line.split()
            if fields[3] == state and fields[9] in mine:
                number = fields[1].split(":")[0]
                parts = [str(int(number[i : i + 2], 16)) for i in (6, 4, 2, 0)]
                out.add(".".join(parts) if len(number) == 8 else number)
    return out


def test_the_status_is_complete_and_no_worker_can_be_reached_from_outside(running):
    running.watch.look_at_all(1.0, 20.0)
    view = running.watch.view()
    assert view.well
    assert 'camera -- "frame, ' in mermaid(view)
    answer = as_json(view)
    assert all(worker["there"] and worker["memory_mib"] > 1.0 for worker in answer["workers"])
    (frames,) = (e for e in answer["edges"] if (e["from"], e["to"]) == ("camera", "tracker"))
    assert frames["rate_hz"] > 0.0
    assert NAME in as_text(view)
    assert {a for m in view.health.values() for a in _listening(m.pid)} == set()
    assert all(m.shared_memory for w, m in view.health.items() if w in ("tracker", "detector"))


def test_no_worker_has_loaded_what_only_onboarding_needs(running):
    running.watch.look_at_all(1.0, 20.0)
    health = running.watch.view().health
    loaded = {worker: Path(f"/proc/{message.pid}/maps").read_text() for worker, message in health.items()}
    assert "/cv2/" in loaded["tracker"]
    assert [worker for worker, maps in loaded.items() if "/open3d/" in maps] == []


def test_a_thousand_bad_messages_a_second_on_every_key_are_counted_and_disturb_no_worker(running, wait_until):
    before = running.watch.view()
    sent = flood(before.pipeline.endpoints, Keys("local", "cam0"), 2.0)
    assert sent >= 1000
    # Of messages with pixels only the newest is read, so fewer are counted there.
    least = {"tracker": 20, "reinit": 20, "detector": 20, "segmenter": 1, "estimator": 1}

    def counted():
        running.watch.look(0.1)
        health = running.watch.view().health
        return all(health[w].errors >= before.health[w].errors + n for w, n in least.items())

    wait_until(counted, 30.0)
    after = running.watch.view()
    assert {w: m.pid for w, m in after.health.items()} == {w: m.pid for w, m in before.health.items()}
    assert after.poses
    assert after.health["tracker"].last_error.startswith("dropped a message on huepose/local/cam0/")


def test_the_list_of_objects_is_changed_while_it_runs(running, recording, wait_until):
    """What cannot be done is refused with the reason."""
    box = recording[2][0].box_visib
    order, instances = running.order, running.instances
    assert [e.object for e in order("list").objects] == [NAME]
    assert f"expected one of {NAME}" in order("add", "teapot").text
    assert "is searched for already" in order("add", NAME).text
    assert not order("remove", "teapot").done
    wait_until(instances, 30.0)
    (first,) = instances()
    assert order("reset", NAME, box=box).done
    wait_until(lambda: instances() and first not in instances(), 60.0)
    assert order("remove", NAME).objects == []
    running.watch.look(1.0)
    last = running.watch.view().poses
    running.watch.look(0.5)
    assert running.watch.view().poses == last, "it was published for more than a second"
    assert order("add", NAME).done
    wait_until(instances, 60.0)


def test_nothing_was_compiled_after_the_workers_were_ready(running):
    """During all tests above."""
    running.watch.look_at_all(1.0, 20.0)
    health = running.watch.view().health
    assert {
        w: m.counters["kernels_compiled_late"]
        for w, m in health.items()
        if "kernels_compiled_late" in m.counters
    } == {}
    assert {"tracker", "estimator", "detector", "segmenter"} <= set(health)


def test_a_second_process_of_a_worker_is_refused_and_the_first_ends_in_order(running):
    second = running.start("run", "segmenter", running.path)
    _, err = second.communicate(timeout=60.0)
    assert second.returncode == 2
    assert f"port {running.watch.pipeline.base_port + 4} of worker segmenter" in err
    running.supervisor.send_signal(signal.SIGTERM)
    _, log = running.supervisor.communicate(timeout=10.0)
    assert running.supervisor.returncode == 0
    assert f"{NAME} is searched for again" in log
    assert "does not stop" not in log


def test_an_unknown_object_is_named_with_the_known_ones(recording, tmp_path, base_port, refused):
    folder, _, _ = recording
    pipeline = {
        "bundles": str(folder / "bundles"),
        "objects": [{"name": "teabox"}],
        "camera": {"source": "bop", "path": str(folder / "scene")},
        "bus": {"base_port": base_port},
    }
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps(pipeline))
    err = refused(["up", path])
    assert err.count("\n") == 1
    assert "'teabox'" in err
    assert f"Did you mean '{NAME}'?" in err
