"""`huepose validate`: what of a file is refused before a worker starts, and what is noted."""

import json
import shutil
import socket
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from huepose.model import save_model
from huepose_services.cli.main import main
from huepose_services.cli.validate import _unread, _unused
from huepose_services.runtime.config import Config
from huepose_services.runtime.config_perception import CameraConfig, DetectorConfig, DeviceConfig
from tests.services.conftest import parse


@pytest.fixture
def validated(tmp_path, capsys):
    """What `huepose validate` prints about a valid text."""

    def validate(text):
        (tmp_path / "pipeline.yaml").write_text(text)
        assert main(["validate", str(tmp_path / "pipeline.yaml")]) == 0
        return capsys.readouterr().out

    return validate


@pytest.mark.parametrize(("text", "noted"), [("", True), ("# later\n", True), ("site: lab\n", False)])
def test_validate_notes_that_a_file_is_empty(validated, text, noted):
    out = validated(text + ("camera: {truth: true}\n" if text.startswith("site") else ""))
    assert ("the file is empty: all defaults apply, with the built-in scene" in out) == noted


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (0, "all of {}"),
        (1, "all of {}: cup0"),
        (3, "all 3 of {}: cup0, cup1, cup2"),
        (7, "all 7 of {}: cup0, cup1, cup2, cup3, cup4 and 2 more"),
    ],
)
def test_validate_names_objects_of_a_folder(tmp_path, pipeline, printed, count, said):
    path, folder = pipeline(), tmp_path / "bundles"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"bundles": "bundles"}))
    folder.mkdir()
    for number in reversed(range(count)):
        (folder / f"cup{number}.huepose").touch()  # only the names are read
    assert f"\n  objects  {said.format(folder)}\n" in printed(["validate", path])


def test_validate_says_which_images_are_missing(scene, pipeline, capsys, printed):
    path = pipeline()
    assert "WARNING" not in printed(["validate", path])
    for number in range(7, 15):
        (scene / "depth" / f"{number:06d}.png").unlink()
    assert main(["validate", str(path)]) == 0
    said = f"  WARNING  {scene}: depth/ lacks 8 of 12 images, the first is number 7; they are left out"
    assert said in capsys.readouterr().out


def _no_depth(scene):
    shutil.rmtree(scene / "depth")


def _depth_of_8_bits(scene):
    cv2.imwrite(str(scene / "depth" / "000003.png"), np.full((48, 64), 90, np.uint8))


def _no_matrix(scene):
    (scene / "scene_camera.json").write_text(json.dumps({n: {"depth_scale": 1.0} for n in range(3, 15)}))


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (_no_depth, "depth/000003.png: found no such file"),
        (_depth_of_8_bits, "depth/000003.png: found uint8 values"),
        (_no_matrix, "scene_camera.json, image 3: found keys depth_scale; expected the key 'cam_K'"),
    ],
)
def test_a_folder_whose_first_image_cannot_be_read_is_refused(scene, pipeline, refused, damage, says):
    path = pipeline()
    damage(scene)
    assert says in refused(["validate", path])
    path.write_text(json.dumps(json.loads(path.read_text()) | {"workers": ["gateway"]}))
    assert main(["validate", str(path)]) == 0, "its camera does not run"


def test_a_folder_of_images_that_are_too_large_to_be_sent_is_refused(scene, pipeline, refused, monkeypatch):
    monkeypatch.setattr("huepose_services.convert.MOST_PIXELS", 2_000)
    for verb in ("validate", "up"):
        assert "image: found 64 x 48 pixels; expected at most" in refused([verb, pipeline()])


def test_validate_says_which_extra_a_worker_needs(tmp_path, refused, monkeypatch):
    path = tmp_path / "pipeline.yaml"
    path.write_text("workers: [camera, tracker, reinit, detector, segmenter, estimator, viewer]\n")
    monkeypatch.setattr("huepose_services.runtime.prepare.find_spec", lambda name: None)
    assert "this needs the Python package rerun; install it with:" in refused(["validate", path])


def test_validate_notes_that_no_worker_searches_for_objects(validated):
    said = "no object is ever found: detector, segmenter, estimator not among the workers"
    out = validated("workers: [camera, tracker, reinit]\ncamera: {source: synthetic}\n")
    assert f"\n  NOTE     {said}\n" in out
    assert "is ever found" not in validated("workers: [camera]\ncamera: {source: synthetic}\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "gateway: {listen: '0.0.0.0:7447'}",
            "the section `gateway` is set, but gateway is not among the workers",
        ),
        ("cpus: {viewer: [0], camera: [0]}", "cpus.viewer is set, but viewer is not among the workers"),
        ("link: {listen: '0.0.0.0:7449'}", "the section `link` is set, but there are no `hosts`"),
    ],
)
def test_validate_notes_a_section_of_a_worker_that_is_not_started(validated, text, said):
    out = validated(f"{text}\n")
    assert (out.count("NOTE"), out.count(f"\n  NOTE     {said}\n")) == (1, 1)


def test_validate_does_not_note_defaults_nor_workers_of_the_other_computer(validated):
    assert "NOTE" not in validated("gateway: {listen: '127.0.0.1:7447'}\n"), "the same as without the line"
    text = (
        "workers: [camera, tracker, reinit, detector, segmenter, estimator, gateway]\n"
        "gateway: {listen: '0.0.0.0:7447'}\nlink: {listen: '0.0.0.0:7449', connect: 'robot:7449'}\n"
        "hosts: {desk: [estimator]}\ncpus: {camera: [0], estimator: [0], uplink: [0], downlink: [0]}\n"
    )
    written = parse(text, Path("p.yaml"))
    for host in (None, "desk"):
        assert _unused(written.at(host), written) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("detector: {model: n.onnx}", "detector.model is set, but detector.kind is views; it is for"),
        ("detector: {confidence: 0.5}", "detector.confidence is set, but detector.kind is views;"),
        ("segmenter: {encoder: a, decoder: b}", "segmenter.encoder is set, but segmenter.kind is depth;"),
        ("camera: {first_frame_s: 1}", "camera.first_frame_s is set, but camera.once is false"),
    ],
)
def test_a_key_that_nothing_reads_is_noted(validated, text, said):
    assert f"\n  NOTE     {said}" in validated(text)


@pytest.mark.parametrize(
    ("text", "noted"),
    [
        ("cameras: [{name: left}]\n", 0),
        ("cameras: [{name: left}, {name: right}]\n", 0),
        ("cameras: [{name: left}, {name: right}]\nros2: {namespace: lab}\n", 2),
    ],
)
def test_validate_notes_no_section_that_the_file_does_not_have(validated, text, noted):
    out = validated(text)
    assert (out.count("NOTE"), out.count("the section `ros2` is set")) == (noted, noted)


def test_threads_of_the_search_are_noted_if_the_detector_is_a_network():
    config = Config(detector=DetectorConfig(kind="yolo", threads=4))
    assert "detector.threads is set, but detector.kind is yolo; it is for views" in _unread(config)
    assert not any("threads" in said for said in _unread(Config(detector=DetectorConfig(threads=4))))


def test_settings_that_the_camera_does_not_read_are_noted():
    camera = CameraConfig(source="python", path="camera.py", once=True, first_frame_s=2.0)
    said = "camera.first_frame_s is set, but camera.source is python; it is for recordings"
    assert _unread(Config(camera=camera)) == [said]
    recording = msgspec.structs.replace(camera, source="bop", path="desk")
    assert _unread(Config(camera=recording)) == []
    device = DeviceConfig(align=False)
    said = "camera.device.align is set, but camera.source is oak; it is for realsense"
    assert _unread(Config(camera=CameraConfig(source="oak", device=device))) == [said]
    assert _unread(Config(camera=CameraConfig(source="realsense", device=device))) == []


def test_keys_that_are_read_give_no_note(validated):
    assert "NOTE" not in validated("detector: {kind: views, threads: 1}\n")


def test_validate_says_that_a_rendered_scene_shows_one_of_each(validated):
    said = "the rendered scene shows one of each: a second tea_box is searched for, but is not there"
    assert said in validated("objects: [{name: tea_box, max_instances: 2}]\ncamera: {source: synthetic}\n")
    assert "one of each" not in validated("objects: [{name: tea_box}]\ncamera: {source: synthetic}\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cpus: {tracker: [1022]}", "cpus: found 1022; expected processors of this computer"),
        ("gateway: {listen: '192.0.2.1:7447'}", "gateway.listen 192.0.2.1:7447: found"),
        ("gateway: {tls: {authority: a.pem, certificate: b.pem, key: c.pem}}", "gateway.tls.authority"),
    ],
)
def test_what_a_worker_would_refuse_at_its_start_is_refused_before(tmp_path, refused, text, says):
    path = tmp_path / "pipeline.yaml"
    path.write_text(f"workers: [camera, tracker, gateway]\ncamera: {{source: synthetic}}\n{text}\n")
    for verb in ("validate", "up"):
        said = refused([verb, path])
        assert said.startswith(f"huepose {verb}: "), "no worker was started"
        assert says in said


@pytest.mark.parametrize(
    ("worker", "section", "says"),
    [
        ("gateway", "gateway: {{listen: '127.0.0.1:{}'}}", "gateway.listen 127.0.0.1:{}: found Address"),
        ("viewer", "viewer: {{web_port: {}}}", "viewer.web_port {}: found Address"),
        ("viewer", "viewer: {{grpc_port: {}}}", "viewer.grpc_port {}: found Address"),
    ],
)
def test_a_port_of_the_network_in_use_is_refused_before_a_worker_starts(
    tmp_path, monkeypatch, refused, worker, section, says
):
    """`validate` accepts the file: the program at that port may be this pipeline."""
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "run"))
    path = tmp_path / "pipeline.yaml"
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        path.write_text(f"workers: [camera, {worker}]\n{section.format(port)}\n")
        assert main(["validate", str(path)]) == 0
        said = refused(["up", path])
    assert said.startswith(f"huepose up: {says.format(port)}")
    assert len(said.splitlines()) == 1


def test_a_renamed_model_is_refused_before_a_worker_finds_it(tmp_path, tea_box, pipeline, refused):
    save_model(tea_box, tmp_path / "bundles" / "my_part.huepose")
    path, changes = pipeline(), {"bundles": "bundles", "workers": ["camera", "tracker", "estimator"]}
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    said = "bundles/my_part.huepose: found the model 'tea_box'; expected the model 'my_part'"
    for verb in ("validate", "up"):
        assert said in refused([verb, path])


def test_settings_of_a_worker_that_does_not_run_are_not_checked(validated):
    validated("workers: [camera]\ncpus: {tracker: [1022]}\ngateway: {listen: '192.0.2.1:7447'}\n")
