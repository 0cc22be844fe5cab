"""pipeline.yaml: an error names the path, the value and what is allowed."""

import re
import time
from pathlib import Path

import msgspec
import pytest

from huepose.support.errors import InputError
from huepose_protos import decode, encode
from huepose_protos.examples import example
from huepose_protos.messages import FrameHeader
from huepose_services.runtime.config import WORKERS, Config, Section
from huepose_services.runtime.config_file import load, load_all, parse_all
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


def test_frames_of_a_camera_with_the_longest_name_are_accepted():
    camera = parse(f"camera: {{name: {50 * 'c'}}}", Path("p.yaml")).camera
    header = msgspec.structs.replace(example(FrameHeader), frame=camera.frame)
    assert decode(encode(header), FrameHeader).frame == camera.frame
