"""All six workers as processes: an object in a recording is acquired from its first box and tracked."""

import json

import cv2
import numpy as np
import pytest

from huepose.datasets.shapes import demo_objects
from huepose.datasets.synthetic import SyntheticScene
from huepose.evaluation.metrics import add
from huepose.model.io import model_path, save_model
from huepose.onboarding import onboard_mesh
from huepose_services.convert import pose_from_wire

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
        "detector": {"kind": "first_box", "boxes": {NAME: list(truths[0].box_visib)}},
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
