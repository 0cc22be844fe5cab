"""pipeline.yaml: an error names the path, the value and what is allowed."""

import json
import re
import shutil
import socket
import time
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from huepose.model import save_model
from huepose.support.errors import InputError
from huepose_protos import decode, encode
from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader
from huepose_services.cli.main import main
from huepose_services.cli.validate import _unread, _unused
from huepose_services.runtime.config import WORKERS, Config, Section, load, load_all, parse_all
from huepose_services.runtime.config_perception import CameraConfig, DetectorConfig, DeviceConfig
from tests.services.conftest import parse

GOOD = "camera: {truth: true}\n"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("camera: {rte: 3}", ["camera.rte", "not known", "Did you mean 'rate'?"]),
        ("camera: {rate: fast}", ["camera.rate", "'fast'", "recorded, or a number"]),
        ("camera: {rate: 0}", ["camera.rate", "found 0", "a number over 0"]),
        ("camera: {rate: 1e9}", ["camera.rate: found 1000000000.0"]),
        ("estimator: {threads: 1e-1}", ["a whole number", "What each key means"]),
        ("camera: {depth_scale_m: 1e-4m}", ["'1e-4m'", "What each key means"]),
        ("camera: {truth: 1e0}", ["true or false", "What each key means"]),
        ("objects: [{nme: a}]", ["objects[0].nme", "name, max_instances"]),
        ("objects: [tea_box]", ["objects[0]", "'tea_box'", "Write {name: tea_box}."]),
        ("workers: [camera, traker]", ["workers[1]", "Did you mean 'tracker'?"]),
        ("objects: [{}]", ["objects[0].name", "found nothing"]),
        ("objects: [{name: 003}]", ["objects[0].name", "found 3", "Put it in quotation marks"]),
        ("objects: [{name: yes}]", ["objects[0].name", "found True", "Put it in quotation marks"]),
        ("gateway: {listen: 7447}", ["gateway.listen", "found 7447", "What each key means"]),
        ("objects: [{name: A B}]", ["objects[0].name", "'A B'", "1 to 64 of a-z, 0-9, _ and -"]),
        (f"camera: {{name: {51 * 'c'}}}", ["camera.name", "at most 50 characters", "_color_optical"]),
        ("objects: [{name: a}, {name: a}]", ["objects", "every name once"]),
        ("workers: [cam]", ["workers[0]", "'cam'", "camera, tracker"]),
        (
            "workers: []",
            [
                "workers: found none; expected one worker or more. Name one, or leave `workers` out: then "
                "camera, tracker, reinit, detector, segmenter, estimator are started."
            ],
        ),
        (
            "cpus: {traker: [0]}",
            ["cpus: found the key 'traker'", "one of camera, tracker", "mean 'tracker'?"],
        ),
        ("cpus: {camera: [0], tracker: [x]}", ["cpus.tracker[0]: found 'x'; expected a whole number."]),
        ("hosts: {desk: [detektor]}", ["hosts.desk[0]: found 'detektor'", "Did you mean 'detector'?"]),
        ("hosts: {My Desk: [detector]}", ["hosts: found the key 'My Desk'; expected 1 to 64 of a-z"]),
        ("camera: {device: {filters: {spatial: {a: x}}}}", ["camera.device.filters.spatial.a: found 'x'"]),
        ("detector: {classes: {mug: [cup, -2]}}", ["detector.classes.mug[1]: found -2"]),
        ("networks: {sha256: {f.onnx: zz}}", ["networks.sha256.f.onnx: found 'zz'", "64 digits 0-9 a-f"]),
        ("camera: {1: x}", ["camera: found the key 1"]),
        ("workers: [camera, camera]", ["found camera, camera; expected each worker at most once."]),
        ("camera: {source: webcam}", ["camera.source", "'webcam'", "synthetic, bop, fast_ycb"]),
        ("camera: {source: opencv}", ["camera.source", "A webcam has no depth", "docs/cameras.md"]),
        ("cameras: [{source: webcam}]", ["cameras[0].source", "A webcam has no depth"]),
        ("camera: {source: bop}", ["camera.path", "null", "folder of the recording"]),
        ("camera: {source: bop, path: x}\nobjects: [{name: a}]", ["bundles", "null"]),
        ("camera: {source: realsense, once: true}", ["camera.once", "false with the source realsense"]),
        ("camera: {source: python, path: a.py, truth: true}", ["camera.truth", "false with the source pyt"]),
        ("camera: {source: realsense}", ["bundles", "null", "realsense", "huepose onboard"]),
        ("camera: {rate: recorded, truth: true}", ["camera.rate", "recorded"]),
        ("camera: {truth: maybe}", ["camera.truth", "'maybe'", "true or false"]),
        ("camera: 7", ["camera", "found 7", "keys with values"]),
        ("gateway: {listen: 7447}", ["gateway.listen", "found 7447", "expected ADDRESS:PORT"]),
        ("link: {connect: 7448}", ["link.connect", "found 7448", "expected ADDRESS:PORT"]),
        ("camera: bop", ["camera", "found 'bop'", "Write {source: bop} there"]),
        ("cameras: [realsense]", ["cameras[0]", "Write {source: realsense} there"]),
        ("workers: [camera, gateway, ros2]", ["gateway.listen", "127.0.0.1:7447", "tcp/localhost:7447"]),
        (
            "camera: {mount: {parent: base, translation: [0, 0, 1], quaternion: [0, 0, 0, 0]}}",
            ["camera.mount", "expected a quaternion of unit length, x y z w."],
        ),
        (
            "cameras: [{name: a, mount: {parent: b, translation: [0, 0, 1], quaternion: [-0.8, 0, 0, 0]}}]",
            ["cameras[0].mount.quaternion", "found [-0.8, 0.0, 0.0, 0.0], of length 0.8"],
        ),
        (
            "camera: {mount: {parent: base, translation: [0, 0, 1]}}",
            ["camera.mount.quaternion: found nothing", "Write [0.0, 0.0, 0.0, 1.0]", "is not rotated"],
        ),
        (
            "camera: {mount: {parent: base, quaternion: [0, 0, 0, 1]}}",
            ["camera.mount.translation: found nothing", "Write [0.0, 0.0, 0.0]", "origin of `parent`"],
        ),
        (
            "camera: {mount: {parent: base link, translation: [0, 0, 1], quaternion: [0, 0, 0, 1]}}",
            ["camera.mount.parent: found 'base link'", "no blank among them"],
        ),
        (
            "camera: {mount: {parent: b, translation: [0, 0, 1], quaterion: [0, 0, 0, 1]}}",
            ["camera.mount.quaterion", "not known", "Did you mean 'quaternion'?"],
        ),
        (
            "camera: {mount: {parent: base, translation: [0, 0, 1], quaternion: [0, 0, 0, .nan]}}",
            ["camera.mount", "not finite"],
        ),
        ("camera: {tf: {parent: base, child: tool0}}", ["camera.tf", "the worker ros2", "Add ros2"]),
        ("workers: [camera, ros2]\ncamera: {tf: {parent: a, child: a}}", ["camera.tf", "two frames"]),
        (
            "workers: [camera, ros2]\ncamera: {tf: {parent: /a, child: b}}",
            ["camera.tf.parent", "'/a'", "no / first"],
        ),
        (
            "workers: [camera, ros2]\ncamera: {tf: {parent: a, child: b}, "
            "mount: {parent: c, translation: [0, 0, 1], quaternion: [0, 0, 0, 1]}}",
            ["camera.mount.parent", "found c", "expected b"],
        ),
        (
            "workers: [camera, ros2]\ncamera: {tf: {parent: a, child: cam0_color_optical}, "
            "mount: {parent: cam0_color_optical, translation: [0, 0, 1], quaternion: [0, 0, 0, 1]}}",
            ["camera.mount", "own frame, cam0_color_optical", "Take it out"],
        ),
        ("bus: {base_port: 80}", ["bus.base_port", "found 80", "a whole number of 1024 or more"]),
        ("gateway: {listen: 'localhost:99999'}", ["gateway.listen", "localhost:99999", "1 to 65535"]),
        ("gateway: {listen: '127.0.0.1:0'}", ["gateway.listen", "127.0.0.1:0", "1 to 65535"]),
        ("ros2: {connect: tcp/localhost:99999}", ["ros2.connect", "tcp/localhost:99999", "1 to 65535"]),
        ("ros2: {connect: tcp/localhost}", ["ros2.connect", "found 'tcp/localhost'", "tcp/HOST:PORT"]),
        (
            "workers: [camera, ros2]\nobjects: [{name: tea-box}, {name: tea_box}]",
            ["objects", "tea-box and tea_box", "- and _"],
        ),
        ("ros2: {namespace: huepose/}", ["ros2.namespace", "huepose/"]),
        ("ros2: {namespace: a//b}", ["ros2.namespace", "a//b"]),
        ("ros2: {namespace: a/1b}", ["ros2.namespace", "a/1b", "none with a digit first"]),
        ("ros2: {frame_prefix: a b}", ["ros2.frame_prefix", "letters, digits, _, / and -"]),
        ("link: {listen: '0.0.0.0:65536'}", ["link.listen", "0.0.0.0:65536", "1 to 65535"]),
        (
            "gateway: {listen: 'localhost:65535'}\ncameras: [{name: a}, {name: b}]",
            ["gateway.listen", "localhost:65536", "1 to 65535"],
        ),
        (
            "workers: [camera, viewer]\nviewer: {web_port: 65535}\ncameras: [{name: a}, {name: b}]",
            ["viewer.web_port: found 65536; expected a port of 1 to 65535. Give another one"],
        ),
        (
            "workers: [camera, viewer]\nviewer: {grpc_port: 65534}\n"
            "cameras: [{name: a}, {name: b}, {name: c}]",
            ["viewer.grpc_port: found 65536; expected a port of 1 to 65535. Give another one"],
        ),
        (
            "workers: [camera, viewer]\nviewer: {web_port: 9197, grpc_port: 9197}",
            ["viewer.grpc_port: found 9197; expected another port than that of viewer.web_port."],
        ),
        (
            "workers: [camera, gateway, viewer]\ngateway: {listen: '0.0.0.0:9876'}",
            ["viewer.grpc_port: found 9876; expected another port than that of gateway.listen."],
        ),
        (
            "workers: [camera, gateway, viewer]\ngateway: {listen: '192.168.7.5:9090'}",
            ["viewer.web_port: found 9090; expected another port than that of gateway.listen."],
        ),
        (
            "workers: [camera, viewer]\nviewer: {grpc_port: 9091}\ncameras: [{name: a}, {name: b}]",
            ["viewer.web_port of b: found 9091; expected another port than that of viewer.grpc_port of a."],
        ),
        (
            "workers: [camera, gateway, detector, segmenter, estimator]\nlink: {connect: 'desk:7448'}\n"
            "gateway: {listen: 'localhost:7448'}\nhosts: {desk: [estimator]}",
            ["link.listen: found 7448; expected another port than that of gateway.listen."],
        ),
        ("- 1", ["the whole file", "found [1]"]),
        ("camera: [", ["YAML", "line 1"]),
        ("site: a\n\tworkers: [camera]", ["line 2", "\\t"]),
        ("camera:\n  rate: 3\n    seed: 1", ["line 3", "YAML"]),
        (
            "camera:\n    rate: 3\n  seed: 1",
            ["line 3, column 3", "Look at the indentation of that line and the one before."],
        ),
        ("site: a\nbus: {}\nsite: b", ["line 3, column 1", "'site' a second time"]),
        ("camera: {seed: 1, seed: 2}", ["line 1", "'seed' a second time"]),
        (
            "objects: !include o.yaml",
            ["line 1", "'!include'). Templates (`{{ }}`) and tags"],
        ),
        (
            "objects: !!set {mug, jar}",
            ["line 1", "2002:set'). Templates (`{{ }}`) and tags"],
        ),
        (
            "site: {{ site }}",
            ["line 1", "(found unhashable key). Templates (`{{ }}`) and"],
        ),
    ],
)
def test_an_error_names_path_value_and_what_is_allowed(text, parts):
    with pytest.raises(InputError) as error:
        parse_all(text, Path("deploy.yaml"))
    message = str(error.value)
    assert message.count("\n") == 0
    assert all(part in message for part in ["deploy.yaml", *parts]), message


@pytest.mark.parametrize(
    "text",
    [
        "workers: [camera, viewer]\nviewer: {grpc_port: 7447}\ngateway: {listen: '127.0.0.1:7447'}",
        "workers: [camera, gateway, viewer]\ngateway: {listen: '192.0.2.1:9876'}",
        "workers: [camera, gateway, viewer]\ncameras: [{name: a}, {name: b}, {name: c}]",
    ],
    ids=["one that is not started", "at another address", "several cameras"],
)
def test_ports_without_a_conflict_are_accepted(text):
    assert parse_all(text, Path("deploy.yaml"))


def test_numbers_may_be_written_with_exponents():
    (config,) = parse_all("camera: {depth_scale_m: 1e-4, rate: 1.5E1, seed: 7, name: cam1}", Path("a.yaml"))
    camera = config.camera
    assert (camera.depth_scale_m, camera.rate, camera.seed, camera.name) == (1e-4, 15.0, 7, "cam1")


def test_relative_paths_start_at_the_file(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("bundles: models\ncamera: {source: bop, path: ../scene, truth: true}\n")
    config = load(path)
    assert config.bundles == str(tmp_path / "models")
    assert config.camera.path == str((tmp_path.parent / "scene").resolve())


@pytest.mark.parametrize("name", ["missing.yaml", ""])
def test_a_file_that_cannot_be_read_is_named(tmp_path, name):
    with pytest.raises(InputError, match="configuration"):
        load(tmp_path / name)


def test_every_worker_has_its_own_port():
    config = parse(GOOD, Path("p.yaml"))
    assert len({config.endpoint(worker) for worker in WORKERS}) == len(WORKERS)


SEVERAL = """
site: lab
bundles: models
gateway: {listen: "0.0.0.0:7000"}
cameras: [{name: left, source: realsense}, {name: top-view, source: python, path: mine.py}]
"""


def test_each_of_several_cameras_has_a_configuration_of_its_own(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(SEVERAL)
    left, top = load_all(path)
    assert [left.camera.name, top.camera.name] == ["left", "top-view"]
    assert [left.keys.frame, top.keys.frame] == ["huepose/lab/left/frame", "huepose/lab/top-view/frame"]
    assert top.camera.path == str(tmp_path / "mine.py")
    assert top.bundles == left.bundles == str(tmp_path / "models")
    ends = [{one.endpoint(w) for w in WORKERS} for one in (left, top)]
    assert not ends[0] & ends[1]
    assert [one.gateway.listen for one in (left, top)] == ["0.0.0.0:7000", "0.0.0.0:7001"]
    assert [one.viewer.web_port for one in (left, top)] == [9090, 9091]
    assert top.ros2.namespace == "huepose/top_view"
    assert load(path, "left") == left
    with pytest.raises(InputError, match="the cameras left, top-view"):
        load(path)
    with pytest.raises(InputError, match="camera right"):
        load(path, "right")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (SEVERAL + "camera: {source: oak}", "found `camera` and `cameras`; expected one of them."),
        (SEVERAL + "camera: {source: synthetic}", "found `camera` and `cameras`; expected one of them."),
        ("cameras: [{name: a}, {name: b}, {name: a}]", "found the names a, b, a; expected every name once."),
        ("cameras: [{}, {}]", "found the names cam0, cam0; expected every name once."),
    ],
)
def test_either_one_camera_or_several_with_different_names(text, says):
    with pytest.raises(InputError) as error:
        parse(text, Path("p.yaml"))
    assert str(error.value).startswith(f"p.yaml: cameras: {says}")


def test_the_default_file_shows_every_key_with_its_default():
    import yaml

    path = Path(__file__).parents[2] / "pipeline.yaml"
    shown = yaml.safe_load(path.read_text())
    config, default = load(path), Config()
    for section in Config.__struct_fields__:
        assert section in shown
        value = getattr(default, section)
        if isinstance(value, Section):
            assert list(shown[section]) == list(value.__struct_fields__)
    # It is the built-in scene, which publishes its truth.
    camera = msgspec.structs.replace(default.camera, truth=True)
    link = msgspec.structs.replace(default.link, secure=str(path.parent / "secure"))
    assert config == msgspec.structs.replace(default, camera=camera, link=link)


PAGES = sorted((Path(__file__).parents[2] / "docs").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_the_pages_show_of_the_file_is_accepted(page, tmp_path):
    """A block that names objects as it is; the others are parts of a file with reference models."""
    for block in re.findall(r"^```yaml\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
        whole = "objects:" in block or "bundles:" in block
        parse_all(block if whole else f"{block}\nbundles: bundles\n", tmp_path / "pipeline.yaml")


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9)
)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 5000,
        "{a: " * 2000,
        "objects: &a [*a]",
        "camera: {device: {options: &a {x: *a}}}",
        "site: 2020-99-99",
        "site: !!int",
        "site: !!timestamp 'x'",
        "bus: {base_port: " + "9" * 5000 + "}",
        "bundles: ~nobody_of_that_name/x",
        'bundles: "a\\0b"',
        "gateway: {tls: {authority: a, certificate: b, kee: c}}",
        "gateway: {tls: {authority: a, certificate: null, key: c}}",
        "site:\n  " + BOMB.replace("\n", "\n  "),
        BOMB + "objects: *a8",
    ],
)
def test_whatever_a_file_says_it_is_an_input_error_soon(text):
    started = time.process_time()
    with pytest.raises(InputError) as error:
        parse(text, Path("pipeline.yaml"))
    assert len(str(error.value)) < 1000
    assert time.process_time() - started < 20.0


def test_a_file_that_never_ends_is_refused():
    with pytest.raises(InputError, match="over 1048576 bytes"):
        load(Path("/dev/zero"))


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
    out = validated(text + (GOOD if text.startswith("site") else ""))
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


def test_frames_of_a_camera_with_the_longest_name_are_accepted():
    camera = parse(f"camera: {{name: {50 * 'c'}}}", Path("p.yaml")).camera
    header = msgspec.structs.replace(example(FrameHeader), frame=camera.frame)
    assert decode(encode(header), FrameHeader).frame == camera.frame
