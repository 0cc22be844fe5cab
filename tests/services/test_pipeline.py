"""All six workers as processes: an object in a recording is found, acquired and tracked."""

import json
import os
import signal
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.poison import flood
from huepose.datasets.shapes import demo_objects
from huepose.datasets.synthetic import SyntheticScene
from huepose.evaluation.metrics import add
from huepose.model.io import model_path, save_model
from huepose.onboarding import onboard_mesh
from huepose_protos.messages import ControlRequest
from huepose_services.cli.graph import mermaid
from huepose_services.cli.objects import ask
from huepose_services.cli.status_text import as_text
from huepose_services.convert import pose_from_wire
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.running import pick
from huepose_services.watch import Watch

pytestmark = pytest.mark.live

NAME = "tea_box"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A second of the built-in scene with one object, as a BOP scene, and the folder of its model."""
    folder = tmp_path_factory.mktemp("recording")
    mesh = demo_objects()[NAME]
    save_model(onboard_mesh(mesh, NAME, object_id=1), model_path(folder / "bundles", NAME))
    scene = SyntheticScene(seconds=1.0, objects={NAME: mesh}, cache=folder)
    (folder / "scene" / "rgb").mkdir(parents=True)
    (folder / "scene" / "depth").mkdir()
    cameras, truths = {}, []
    for i, sample in enumerate(scene):
        rgb = np.ascontiguousarray(sample.frame.color[..., ::-1])
        cv2.imwrite(str(folder / "scene" / "rgb" / f"{i:06d}.png"), rgb)
        depth = np.rint(sample.frame.depth * 10_000).astype(np.uint16)
        cv2.imwrite(str(folder / "scene" / "depth" / f"{i:06d}.png"), depth)
        cameras[str(i)] = {"cam_K": scene.camera.K.ravel().tolist(), "depth_scale": 0.1}
        truths.append(sample.truths[0])
    (folder / "scene" / "scene_camera.json").write_text(json.dumps(cameras))
    return folder, mesh, truths


@pytest.mark.live
@pytest.mark.timeout(240)
def test_a_recording_gives_a_pose_for_nearly_every_frame(recording, huepose, base_port, tmp_path):
    folder, mesh, truths = recording
    pipeline = {
        "bundles": str(folder / "bundles"),
        "objects": [{"name": NAME}],
        # Slow, so that the test is about the pipeline and not about how busy the machine is.
        "camera": {
            "source": "bop",
            "path": str(folder / "scene"),
            "rate": 6,
            "once": True,
            "first_frame_s": 20,
        },
        "bus": {"base_port": base_port},
    }
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps(pipeline))
    printer = huepose("poses", "--json", "--config", path)
    process = huepose("up", path)
    out, err = process.communicate(timeout=200.0)
    assert process.returncode == 0, err
    lines, _ = printer.communicate(timeout=20.0)
    assert printer.returncode == 0
    poses = [json.loads(line) for line in lines.splitlines()]
    with_pose = {p["frame_id"]: p for p in poses if p["translation"] is not None}
    assert len(with_pose) >= 0.95 * len(truths), err
    assert {(p["object"], p["instance"]) for p in poses} == {(NAME, poses[0]["instance"])}
    errors = [
        add(mesh.vertices, pose_from_wire(p["translation"], p["quaternion"]), truths[i].T_cam_obj)
        for i, p in with_pose.items()
    ]
    assert np.mean(np.array(errors) < 0.017) > 0.95
    assert all(p["capture_ns"] < p["publish_ns"] for p in poses)
    assert [p["frame_id"] for p in poses] == sorted(p["frame_id"] for p in poses)


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


@pytest.mark.live
@pytest.mark.timeout(240)
def test_a_running_pipeline_takes_poison_and_orders(recording, huepose, base_port, tmp_path, wait_until):
    folder, _, truths = recording
    path = tmp_path / "pipeline.yaml"
    pipeline = {
        "bundles": str(folder / "bundles"),
        "objects": [{"name": NAME}],
        "camera": {"source": "bop", "path": str(folder / "scene"), "rate": 10},
        "detector": {"kind": "first_box", "boxes": {NAME: list(truths[0].box_visib)}},
        # Late on a busy machine is not what this is about.
        "reinit": {"deadline_ms": 3000},
        "tracker": {"history_frames": 60, "max_age_ms": 2000},
        "restarts": {"hung_after_s": 60},
        "bus": {"base_port": base_port},
    }
    path.write_text(json.dumps(pipeline))
    supervisor = huepose("up", path)
    with Watch(pick(path)) as watch:

        def instances():
            watch.look(0.1)
            return {k[1] for k, p in watch.view().poses.items() if p.state in ("TRACKING", "SUSPECT")}

        wait_until(instances, 60.0)
        watch.look_at_all(1.0, 20.0)
        before = watch.view()
        assert before.well
        assert 'camera -- "frame, ' in mermaid(before)
        assert NAME in as_text(before)
        # Nobody outside of this machine can reach a worker.
        assert {a for m in before.health.values() for a in _listening(m.pid)} == {"127.0.0.1"}

        # A thousand bad messages a second on every key: counted by all that listen, and nobody is disturbed.
        sent = flood(before.pipeline.endpoints, "local", "cam0", seconds=2.0, rate_hz=1000.0)
        assert sent >= 1000
        # Of pixels only the newest are looked at, so fewer are counted there.
        least = {"tracker": 20, "reinit": 20, "detector": 20, "segmenter": 1, "estimator": 1}

        def counted():
            watch.look(0.1)
            return all(watch.view().health[w].errors >= before.health[w].errors + n for w, n in least.items())

        wait_until(counted, 20.0)
        after = watch.view()
        assert {w: m.pid for w, m in after.health.items()} == {w: m.pid for w, m in before.health.items()}
        assert after.poses
        assert after.health["tracker"].last_error.startswith("dropped a message on huepose/local/cam0/")

        # The list of objects is changed while it runs; what cannot be done is refused with the reason.
        def order(action, name=None, **more):
            request = ControlRequest(publish_ns=now_ns(), action=action, object=name, **more)
            return ask(before.pipeline, request)

        assert [e.object for e in order("list").objects] == [NAME]
        assert f"expected one of {NAME}" in order("add", "teapot").text
        assert "is looked for already" in order("add", NAME).text
        assert not order("remove", "teapot").done
        (first,) = instances()
        assert order("reset", NAME, box=truths[0].box_visib).done
        wait_until(lambda: instances() and first not in instances(), 30.0)
        assert order("remove", NAME).objects == []
        watch.look(1.0)
        last = watch.view().poses
        watch.look(0.5)
        assert watch.view().poses == last, "it was published for more than a second"
        assert order("add", NAME, box=truths[0].box_visib).done
        wait_until(instances, 30.0)

    second = huepose("run", "segmenter", path)
    _, err = second.communicate(timeout=60.0)
    assert second.returncode == 2
    assert f"port {base_port + 4} of worker segmenter" in err
    supervisor.send_signal(signal.SIGTERM)
    _, log = supervisor.communicate(timeout=10.0)
    assert supervisor.returncode == 0
    assert f"{NAME} is searched for anew" in log
    assert "does not stop" not in log


def test_an_unknown_object_is_named_with_the_known_ones(recording, huepose, base_port, tmp_path):
    folder, _, _ = recording
    pipeline = {
        "bundles": str(folder / "bundles"),
        "objects": [{"name": "teabox"}],
        "camera": {"source": "bop", "path": str(folder / "scene")},
        "detector": {"kind": "first_box", "boxes": {"teabox": [0, 0, 9, 9]}},
        "bus": {"base_port": base_port},
    }
    path = tmp_path / "pipeline.yaml"
    path.write_text(json.dumps(pipeline))
    process = huepose("up", path)
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 2
    assert err.count("\n") == 1
    assert "'teabox'" in err
    assert NAME in err
