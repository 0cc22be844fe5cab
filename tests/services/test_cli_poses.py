"""What `huepose poses` prints of a pose, in the camera's frame and in the robot's."""

import json
import os
import time
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh
from msgspec.structs import replace

from huepose.evaluation.pose_files import read_pose_csv
from huepose.support.errors import InputError
from huepose_protos import encode
from huepose_protos.examples import example, messages
from huepose_protos.fields import is_name
from huepose_protos.keys import Keys, tail_of
from huepose_protos.local import endpoint
from huepose_protos.messages import HealthMessage, Mount, ObjectEntry, ObjectsMessage, PoseMessage
from huepose_protos.motion import carried
from huepose_services.cli.main import build_parser, main
from huepose_services.cli.pose_export import PoseFiles
from huepose_services.cli.poses import _HEADING, _print, _silence, _warn
from huepose_services.runtime.config_file import load
from huepose_services.runtime.running import Pipeline, described, noted
from tests.disk import full_disk
from tests.services.repeating import repeating
from tests.services.sessions import listening

NO_POSE = ("translation", "quaternion", "velocity_linear", "velocity_angular", "covariance")
HALF = 0.5**0.5
MOUNT = Mount(parent="base_link", translation=(1.0, 0.0, 0.5), quaternion=(0.0, 0.0, HALF, HALF))
"""Rotated by 90 degrees about z, from x to y."""


@pytest.fixture(scope="module")
def pose():
    found = next(m for m in messages() if isinstance(m, PoseMessage) and m.state == "TRACKING")
    return replace(found, translation=(0.1, 0.2, 0.8), quaternion=(0.0, 0.0, 0.0, 1.0))


def test_a_pose_is_printed_in_the_robots_frame(pose, capsys):
    _print(carried(pose, MOUNT, still=True), as_json=False)
    where = "+0.8000 +0.1000 +1.3000 m   +0.0000 +0.0000 +0.7071 +0.7071"
    assert where in capsys.readouterr().out


def test_a_pose_in_the_robots_frame_is_printed_as_a_message(pose, capsys):
    along_x = [1e-4, *[0.0] * 35]
    seen = replace(
        pose, velocity_linear=(0.3, 0.0, 0.0), velocity_angular=(0.0, 0.0, 1.0), covariance=along_x
    )
    _print(carried(seen, MOUNT, still=True), as_json=True)
    message = json.loads(capsys.readouterr().out)
    assert message["frame"] == "base_link"
    np.testing.assert_allclose(message["translation"], [0.8, 0.1, 1.3])
    np.testing.assert_allclose(message["quaternion"], [0.0, 0.0, HALF, HALF])
    np.testing.assert_allclose(message["velocity_linear"], [0.0, 0.3, 0.0], atol=1e-12)
    np.testing.assert_allclose(message["velocity_angular"], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(np.flatnonzero(np.array(message["covariance"]) > 1e-9), [7])  # along y now
    assert carried(seen, MOUNT, still=False).velocity_linear is None
    lost = replace(seen, state="LOST", **dict.fromkeys(NO_POSE))
    assert carried(lost, MOUNT, still=True) == replace(lost, frame="base_link")


def test_a_full_disk_is_named_and_no_empty_file_is_left(pose, tmp_path):
    csv, tum = tmp_path / "object.csv", tmp_path / "tum"
    with full_disk(), pytest.raises(InputError, match=f"{csv}: found File too large"), PoseFiles(csv, None):
        pass
    assert not csv.exists()
    with PoseFiles(csv, tum) as files:
        files.take(pose)
        written = csv.read_bytes()
        with full_disk(len(written)), pytest.raises(InputError, match=f"{csv}: found File too large"):
            files.take(pose)
    assert csv.read_bytes() == written


def test_poses_end_quietly_when_the_reader_of_their_csv_has_ended(pose, capsys, monkeypatch):
    """As `huepose poses --csv /dev/stdout | head` does."""
    read, write = os.pipe()

    def published(*_):
        yield pose
        os.close(read)
        yield from [pose] * 3

    monkeypatch.setattr("huepose_services.cli.poses._messages", published)
    monkeypatch.setattr("huepose_services.cli.main._discard_output", lambda out: None)
    assert main(["poses", "--csv", f"/dev/fd/{write}"]) == 0
    os.close(write)
    assert capsys.readouterr().err == ""


def test_tracking_poses_are_written_for_calibration_and_as_trajectories(pose, tmp_path):
    at = replace(
        pose, object="mug", instance=2, frame_id=7, capture_ns=5, realtime_offset_ns=1_700_000_000 * 10**9
    )
    csv, tum = tmp_path / "object.csv", tmp_path / "tum"
    with PoseFiles(csv, tum) as files:
        files.take(at)
        files.take(replace(at, frame_id=8, state="SUSPECT"))
        files.take(replace(at, frame_id=9, state="LOST", translation=None, quaternion=None))
        files.take(next(m for m in messages() if not isinstance(m, PoseMessage)))
        files.take(replace(at, frame_id=10, object="jar", instance=0))
        assert files.written == 2
    heading, row, _ = csv.read_text().splitlines()
    assert heading == "frame,object,x,y,z,qx,qy,qz,qw,instance,stamp,quality"
    assert row.startswith("7,mug,0.1")
    assert row.split(",")[9:] == ["2", "1700000000.000000005", f"{pose.quality:.4f}"]
    poses = read_pose_csv(csv).poses
    assert list(poses) == [(7, "mug"), (10, "jar")]
    np.testing.assert_allclose(poses[7, "mug"][:3, 3], [0.1, 0.2, 0.8])
    assert {path.name for path in tum.iterdir()} == {"mug_2.txt", "jar_0.txt"}
    heading, line = (tum / "mug_2.txt").read_text().splitlines()
    assert heading == "# timestamp tx ty tz qx qy qz qw"
    assert line.startswith("1700000000.000000005 0.1")
    assert [float(value) for value in line.split()[1:]] == [0.1, 0.2, 0.8, 0.0, 0.0, 0.0, 1.0]


def test_quaternions_of_an_instance_keep_their_sign_from_row_to_row(pose, tmp_path):
    """Also if a pose has the opposite quaternion of the same rotation; each instance has its own sign."""
    csv, tum = tmp_path / "object.csv", tmp_path / "tum"
    nearly, other = (0.0, 0.0, 0.1, 0.995), (0.0, 0.0, -0.1, -0.995)
    with PoseFiles(csv, tum) as files:
        for instance, quaternion in ((0, nearly), (0, other), (1, other), (0, nearly), (0, other)):
            files.take(replace(pose, object="mug", instance=instance, quaternion=quaternion))
    rows = [[float(value) for value in row.split(",")[5:9]] for row in csv.read_text().splitlines()[1:]]
    assert rows == [[*nearly], [*nearly], [*other], [*nearly], [*nearly]]
    assert all(row.endswith(" 0.100000000 0.995000000") for row in lines(tum / "mug_0.txt"))
    assert all(row.endswith(" -0.100000000 -0.995000000") for row in lines(tum / "mug_1.txt"))


def lines(path):
    """The lines of poses in a file of TUM's format."""
    _, *poses = path.read_text().splitlines()
    assert poses
    return poses


def test_poses_that_were_written_before_are_not_overwritten(pose, tmp_path):
    csv, tum = tmp_path / "object.csv", tmp_path / "tum"
    with PoseFiles(csv, tum) as files:
        files.take(pose)
    before = csv.read_bytes()
    with pytest.raises(InputError, match=rf"{csv}: found a file of that name; expected a new one"):
        PoseFiles(csv, None)
    with pytest.raises(InputError, match=rf"{tum}: found something there; expected a new or empty folder"):
        PoseFiles(tmp_path / "other.csv", tum)
    assert csv.read_bytes() == before
    assert not (tmp_path / "other.csv").exists()


def test_the_help_says_how_poses_of_a_bag_are_matched_with_its_images(capsys):
    with pytest.raises(SystemExit):
        build_parser().parse_args(["poses", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "the time is that of playback, and `frame` is the number of the image in the recording" in said


def test_poses_of_one_object_are_written_without_the_others(pose, tmp_path, monkeypatch, refused):
    """An object's name stands for the key of its poses; a key of other messages is refused."""
    asked = []
    monkeypatch.setattr(
        "huepose_services.cli.poses._messages",
        lambda arguments, *rest: asked.append(arguments.key) or iter([replace(pose, state="TRACKING")]),
    )
    assert main(["poses", "mug", "--csv", str(tmp_path / "a.csv")]) == 0
    assert asked == ["pose/mug/**"]
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 2
    assert "found objects beside it" in refused(["poses", "objects", "--csv", tmp_path / "b.csv"])


def test_without_a_pose_no_file_is_left_for_the_next_try(pose, tmp_path, monkeypatch):
    for state, code in (("SUSPECT", 1), ("TRACKING", 0)):
        said = replace(pose, state=state)
        monkeypatch.setattr("huepose_services.cli.poses._messages", lambda *_, said=said: iter([said]))
        assert main(["poses", "--csv", str(tmp_path / "a.csv")]) == code


def test_files_of_poses_and_the_robots_frame_exclude_each_other(tmp_path, refused):
    assert "found --robot beside it" in refused(["poses", "--csv", tmp_path / "a.csv", "--robot"])
    assert not (tmp_path / "a.csv").exists()


def test_poses_in_the_robots_frame_need_a_camera_mount(tmp_path, refused):
    path = tmp_path / "pipeline.yaml"
    path.write_text("bus: {base_port: 29247}\ncamera: {source: synthetic}\n")
    said = refused(["poses", "--robot", "--config", path])
    assert said.startswith("huepose poses: "), "no heading of poses that do not come"
    assert "found no camera.mount" in said
    assert "camera.moving or camera.tf" in said


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("spray_bottle", "pose/spray_bottle/**"),
        ("pose/mug/0", "pose/mug/0"),
        ("health/**", "health/**"),
        ("*", "*"),
    ],
)
def test_an_object_s_name_stands_for_its_poses(given, meant):
    assert build_parser().parse_args(["poses", given]).key == meant
    assert build_parser().parse_args(["poses"]).key == "pose/**"


@pytest.mark.parametrize("text", ["", "pose//mug", "/mug", "mug/", "#", "mug?"])
def test_a_text_that_cannot_be_a_key_is_refused(text, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["poses", text])
    assert ended.value.code == 2
    assert f"found '{text}', expected an object's name, or a key such as pose/**" in capsys.readouterr().err
    assert build_parser().parse_args(["poses", "**/**"]).key == "**", "but keys are put in order"


def test_keys_that_could_be_an_object_s_name_stay_keys():
    keys = Keys("lab", "cam0")
    tails = {tail_of(getattr(keys, name)) for name, key in vars(Keys).items() if hasattr(key, "_tail")}
    names = {tail for tail in tails if is_name(tail)}
    assert {"objects", "truth"} <= names
    assert {build_parser().parse_args(["poses", name]).key for name in names} == names


@pytest.mark.live
@pytest.mark.parametrize("gateway", [False, True])
def test_an_object_that_is_not_searched_for_is_refused_with_those_that_are(
    gateway, pose, base_port, huepose, tmp_path
):
    path = tmp_path / "pipeline.yaml"
    path.write_text(f"site: lab\nbus: {{base_port: {base_port}}}\ncamera: {{source: synthetic}}\n")
    where = f"tcp/127.0.0.1:{base_port}" if gateway else endpoint(base_port)
    choice = ["--gateway", f"127.0.0.1:{base_port}"] if gateway else ["--config", path]
    head = "huepose/lab/cam0/remote" if gateway else "huepose/lab/cam0"
    entries = [ObjectEntry(object=name, max_instances=1, searching=1) for name in ("biscuit", "jar")]

    def publish(number):
        listed = ObjectsMessage(publish_ns=time.monotonic_ns(), objects=entries)
        session.put(f"{head}/objects", encode(listed))
        session.put(f"{head}/pose/jar/0", encode(replace(pose, object="jar", instance=0)))

    with zenoh.open(listening(where)) as session, repeating(publish, 0.05):
        # A gateway shows no workers.
        there = None if gateway else session.liveliness().declare_token(f"{head}/live/tracker")
        misspelt = huepose("poses", "biscit", *choice)
        strange = huepose("poses", "cup", *choice)
        headed = huepose("poses", "jar", *choice)
        known = huepose("poses", "jar", "--json", *choice)
        for process, fix in (
            (misspelt, "Did you mean 'biscuit'?"),
            (strange, "Search for it: huepose objects add cup"),
        ):
            said = process.communicate(timeout=30.0)[1]
            assert process.returncode == 2
            assert "found no object of that name that is searched for; expected one of biscuit, jar." in said
            assert said.endswith(f"{fix}\n")
            assert _HEADING not in said
        assert " jar/0 " in [headed.stdout.readline() for _ in range(2)][1]
        headed.terminate()
        assert headed.communicate(timeout=30.0)[1].splitlines().count(_HEADING) == 1
        lines = [json.loads(known.stdout.readline()) for _ in range(30)]
        assert {line["object"] for line in lines} == {"jar"}
        known.terminate()
        del there


@pytest.mark.live
def test_the_reason_why_no_pose_comes_in_the_robots_frame_is_given(pose, base_port, huepose, tmp_path):
    path = tmp_path / "pipeline.yaml"
    path.write_text(
        f"site: lab\nbus: {{base_port: {base_port}}}\ncamera: {{source: synthetic, moving: true}}\n"
    )

    def publish(number):
        now = time.monotonic_ns()
        message = replace(pose, frame_id=number, capture_ns=now, publish_ns=now)
        session.put(f"huepose/lab/cam0/pose/{pose.object}/0", encode(message))

    with noted(described(load(path), path)):
        printing = huepose("poses", "--robot", "--json", "--config", path)
        lines = iter(printing.stderr.readline, "")
        assert any(f"lab/cam0, from {path}, is being started" in line for line in lines)
        with zenoh.open(listening(endpoint(base_port))) as session, repeating(publish, 0.05):
            assert any("the camera pose is not known" in line for line in lines)
    printing.terminate()


@pytest.mark.live
def test_poses_that_stop_are_reported(pose, base_port, huepose, tmp_path):
    path = tmp_path / "pipeline.yaml"
    path.write_text(f"site: lab\nbus: {{base_port: {base_port}}}\nworkers: [tracker]\n")

    def publish(number):
        session.put(f"huepose/lab/cam0/pose/{pose.object}/0", encode(replace(pose, frame_id=number)))

    with noted(described(load(path), path)), zenoh.open(listening(endpoint(base_port))) as session:
        there = session.liveliness().declare_token("huepose/lab/cam0/live/tracker")
        with repeating(publish, 0.05):
            printing = huepose("poses", "--config", path)
            assert pose.object in printing.stdout.readline()
        lines = iter(printing.stderr.readline, "")
        assert any(
            "the pipeline runs, but no pose has come for 3 s; `huepose status`" in line for line in lines
        )
        del there
    printing.terminate()


def test_the_reason_why_no_pose_comes_names_the_missing_workers():
    """Also if poses of a single object are asked for."""
    workers = ("camera", "tracker", "detector", "gateway")
    pipeline = Pipeline(base_port=17447, site="local", camera="cam0", workers=workers, folder="/run")
    for there, said in (
        (("tracker", "camera", "detector"), "the pipeline runs, but no object has been found yet; "),
        (("camera",), "the pipeline runs without tracker, detector: starting, or ended; "),
    ):
        reader = SimpleNamespace(seen=True, live={f"huepose/local/cam0/live/{worker}" for worker in there})
        assert _silence(reader, pipeline, pipeline.key("pose/**")).startswith(said)
    assert "without tracker, detector" in _silence(reader, pipeline, pipeline.key("pose/mug/**"))


def test_the_reason_why_no_truth_comes_names_the_configuration_key():
    pipeline = Pipeline(base_port=17447, site="local", camera="cam0", workers=("camera",), folder="/run")
    reader = SimpleNamespace(seen=True, live=set())
    said = "nothing is published on huepose/local/cam0/truth: it needs `camera.truth: true`"
    assert said in _silence(reader, pipeline, pipeline.key("truth"))


def test_a_warning_is_printed_once_also_if_its_numbers_change(capsys: pytest.CaptureFixture[str]) -> None:
    late = ["late 12 times, by up to 0.15 s", "late 13 times, by up to 0.2 s"]
    names = ["part_1 is wrong", "part_2 is wrong", "cup/0 is wrong", "cup/1 is wrong"]
    warned: set[str] = set()
    for text in [*late, *names, *names]:
        health = replace(example(HealthMessage), worker="camera", warnings=[text])
        _warn(health, warned)
    printed = capsys.readouterr().err.splitlines()
    assert printed == [f"camera: {text}" for text in [late[0], *names]]
