"""`huepose estimate`: files in; JSON, an image and an explanation out; and the errors if something is
missing."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.believe.state import State
from huepose.estimation import PoseEstimate
from huepose.geometry import RgbdFrame, se3
from huepose.model import ReferenceModel, save_model
from huepose.support.errors import InputError
from huepose_services.cli.estimate import in_words
from huepose_services.cli.main import main
from tests.boxes import box_of
from tests.conftest import TakePicture
from tests.services.conftest import Says


@pytest.fixture(scope="module")
def files(
    tmp_path_factory: pytest.TempPathFactory,
    tea_box: ReferenceModel,
    box_frame: RgbdFrame,
) -> list[str]:
    """A frame and a bundle on disk, as the arguments that name them."""
    return written(tmp_path_factory.mktemp("frame"), box_frame, tea_box)


def written(folder: Path, frame: RgbdFrame, *models: ReferenceModel) -> list[str]:
    """Writes a frame and models; gives the arguments that name them."""
    cv2.imwrite(str(folder / "color.png"), frame.color[..., ::-1])
    cv2.imwrite(str(folder / "depth.png"), np.round(frame.depth * 10000).astype(np.uint16))
    numbers = {key: getattr(frame.camera, key) for key in ("fx", "fy", "cx", "cy", "width", "height")}
    (folder / "camera.json").write_text(json.dumps(numbers | {"depth_scale_m": 0.0001}))
    for model in models:
        save_model(model, folder / "bundles" / f"{model.name}.huepose")
    paths = {"color": "color.png", "depth": "depth.png", "camera": "camera.json", "bundles": "bundles"}
    return ["estimate", *(x for k, v in paths.items() for x in (f"--{k}", str(folder / v)))]


def other(files: list[str], option: str, path: Path) -> list[str]:
    """The arguments with another file."""
    at = files.index(option) + 1
    return [*files[:at], str(path), *files[at + 1 :]]


def other_camera(files: list[str], path: Path, **times: float) -> list[str]:
    """The arguments with a camera some of whose numbers are multiplied."""
    camera = json.loads(Path(files[files.index("--camera") + 1]).read_text())
    path.write_text(json.dumps(camera | {key: by * camera[key] for key, by in times.items()}))
    return other(files, "--camera", path)


def beside(T: np.ndarray, *shifts: list[float]) -> list[np.ndarray]:
    """A pose (4, 4) with each of these shifts, metres."""
    return [se3.make(T[:3, :3], T[:3, 3] + shift) for shift in shifts]


@pytest.fixture(scope="module")
def box(tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray) -> list[str]:
    bounds = box_of(box_frame, tea_box, standing)
    return ["--box", *(str(x) for x in bounds)]


def test_all_instances_are_found_and_no_others(
    tmp_path: Path,
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
    printed: Says,
) -> None:
    truths = beside(standing, *([0.13 * (k - 1.5), 0.0, 0.03 * k] for k in range(4)))
    files = written(tmp_path, take_picture([(tea_box.mesh, T) for T in truths]), tea_box)
    poses = json.loads(printed([*files, "--instances", "6", "--json", "-"]))["poses"]
    assert len(poses) == 4, "and none that is not there"
    x = sorted(pose["T_cam_obj"][0][3] for pose in poses)
    np.testing.assert_allclose(x, [T[0, 3] for T in truths], atol=0.003)


def test_each_instance_has_its_explanation_and_no_more_are_given_than_requested(
    tmp_path: Path,
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
    printed: Says,
) -> None:
    truths = beside(standing, [-0.1, 0.0, 0.0], [0.1, 0.0, 0.0])
    files = written(tmp_path, take_picture([(tea_box.mesh, T) for T in truths]), tea_box)
    assert len(json.loads(printed([*files, "--json", "-"]))["poses"]) == 1
    poses = json.loads(printed([*files, "--instances", "2", "--json", "-", "--explain", tmp_path / "why"]))[
        "poses"
    ]
    records = [json.loads((tmp_path / "why" / f"tea_box{k}_scores.json").read_text()) for k in ("", "_2")]
    assert [r["quality"] for r in records] == [p["quality"] for p in poses]
    np.testing.assert_allclose(
        [r["poses"][0]["T_cam_obj"] for r in records], [p["T_cam_obj"] for p in poses], atol=0.02
    )


@pytest.mark.parametrize(("number", "said"), [("0", "1 or more"), ("2", "one of the two")])
def test_an_invalid_number_of_instances_is_refused(
    number: str, said: str, files: list[str], box: list[str], refused: Says
) -> None:
    assert said in refused([*files, *box, "--instances", number])


def test_a_pose_is_written_as_json_image_and_explanation(
    files: list[str], box: list[str], tmp_path: Path, standing: np.ndarray
) -> None:
    out, image, why = tmp_path / "out.json", tmp_path / "out.png", tmp_path / "why"
    results = ["--json", str(out), "--image", str(image), "--explain", str(why)]
    assert main([*files, *box, "--object", "tea_box", *results]) == 0
    (pose,) = json.loads(out.read_text())["poses"]
    keys = {"object", "found", "reason", "T_cam_obj", "quality", "covariance", "state", "box", "seconds"}
    assert set(pose) == keys
    assert pose["found"]
    assert pose["state"] == "TRACKING"
    assert np.abs(np.array(pose["T_cam_obj"]) - standing).max() < 0.01
    assert np.array(pose["covariance"]).shape == (6, 6)
    assert cv2.imread(str(image)).shape == (480, 640, 3)
    names = {f"tea_box_{part}" for part in ("why.png", "masks.png", "views.png", "pose.png", "scores.json")}
    assert {p.name for p in why.iterdir()} == names
    record = json.loads((why / "tea_box_scores.json").read_text())
    assert record["doubts"] == []
    scores = record["poses"]
    assert 0.0 == scores[0]["behind"] < scores[1]["behind"]
    assert scores[0]["terms"]["color"] > 0.5


def test_without_a_box_the_object_is_found_in_the_whole_image(
    files: list[str], printed: Says, standing: np.ndarray
) -> None:
    (pose,) = json.loads(printed([*files, "--json"]))["poses"]
    assert pose["found"]
    assert pose["reason"] is None
    assert np.abs(np.array(pose["T_cam_obj"]) - standing).max() < 0.01


def test_depth_of_another_unit_is_named_if_nothing_is_found(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([*other_camera(files, tmp_path / "camera.json", depth_scale_m=10.0), "--json"])
    (pose,) = json.loads(capsys.readouterr().out)["poses"]
    assert not pose["found"]
    assert pose["reason"].endswith("is the depth scale right?")


def test_no_pose_is_tracking_if_sizes_do_not_fit_unless_the_check_is_off(
    files: list[str], box: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [*other_camera(files, tmp_path / "camera.json", fx=1.15, fy=1.15), *box, "--json"]
    main(arguments)
    said = json.loads(capsys.readouterr().out)
    (pose,) = said["poses"]
    assert (pose["found"], pose["state"]) == (True, "SUSPECT")
    assert said["doubts"] == [pose["reason"]]
    assert "smaller than their depth says" in pose["reason"]
    main([*arguments, "--no-check-camera"])
    said = json.loads(capsys.readouterr().out)
    assert (said["poses"][0]["state"], said["poses"][0]["reason"]) == ("TRACKING", None)


def test_of_several_objects_only_the_one_of_another_size_is_suspect(
    box_and_can: dict[str, ReferenceModel],
    larger_box: Callable[[float], RgbdFrame],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = [*written(tmp_path, larger_box(1.15), *box_and_can.values()), "--json"]
    main(arguments)
    said = json.loads(capsys.readouterr().out)
    can, box = sorted(said["poses"], key=lambda pose: str(pose["object"]))
    assert (can["state"], can["reason"], said["doubts"]) == ("TRACKING", None, [])
    assert (box["found"], box["state"]) == (True, "SUSPECT")
    assert "larger than its mesh, while other objects fit" in box["reason"]
    main([*arguments, "--no-check-camera"])
    said = json.loads(capsys.readouterr().out)
    assert not any("than its mesh" in str(pose["reason"]) for pose in said["poses"])


def test_no_pose_is_tracking_if_depth_is_far_out_of_alignment(
    files: list[str], box: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    depth = cv2.imread(files[files.index("--depth") + 1], cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "depth.png"), np.roll(depth, 20, axis=1))
    main([*other(files, "--depth", tmp_path / "depth.png"), *box, "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["poses"][0]["state"] != "TRACKING"
    assert "20.0 px to the left" in said["doubts"][0]
    assert not any("than their depth says" in doubt for doubt in said["doubts"]), (
        "only the alignment is reported"
    )


@pytest.mark.parametrize(("option", "place"), [("--explain", "why"), ("--image", "out.png")])
def test_if_an_image_cannot_be_written_the_answer_is_still_given(
    option: str,
    place: str,
    files: list[str],
    box: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def full(path: Path, image: np.ndarray) -> None:
        raise InputError(path, found="No space left on device", expected="a place that can be written")

    for module in ("estimate", "explain"):
        monkeypatch.setattr(f"huepose_services.cli.{module}.write_picture", full)
    out = tmp_path / "out.json"
    assert main([*files, *box, "--json", str(out), option, str(tmp_path / place)]) == 2
    said = capsys.readouterr()
    assert said.out.startswith("tea_box                  TRACKING")
    assert json.loads(out.read_text())["poses"][0]["found"]
    assert f"huepose estimate: {tmp_path / place}" in said.err
    assert "found No space left on device" in said.err


def test_the_reason_why_an_object_is_not_found_is_given_and_drawn(
    files: list[str],
    tea_box: ReferenceModel,
    take_picture: TakePicture,
    standing: np.ndarray,
    tmp_path: Path,
    printed: Says,
) -> None:
    """A look-alike, of the same shape with another texture, is in the place of the object."""
    look_alike = replace(tea_box.mesh, texture=np.ascontiguousarray(tea_box.mesh.texture[::-1, ::-1, ::-1]))
    cv2.imwrite(str(tmp_path / "color.png"), take_picture([(look_alike, standing)]).color[..., ::-1])
    arguments = other(files, "--color", tmp_path / "color.png")
    (pose,) = json.loads(printed([*arguments, "--explain", tmp_path / "why", "--json"]))["poses"]
    assert not pose["found"]
    assert re.search(r"probability of 0\.\d\d, which is under 0\.60: [a-z ]+\.$", pose["reason"])
    record = json.loads((tmp_path / "why" / "tea_box_scores.json").read_text())
    assert (record["state"], record["reason"]) == ("LOST", pose["reason"]), "as in the answer"
    page = cv2.imread(str(tmp_path / "why" / "tea_box_places.png"))
    assert page.shape[0] > 480
    assert page.shape[1] == 640


def test_poses_of_the_papers_method_are_never_tracking(
    files: list[str], box: list[str], tmp_path: Path, standing: np.ndarray
) -> None:
    out, why = tmp_path / "out.json", tmp_path / "why"
    arguments = [*files, *box, "--method", "paper", "--json", str(out), "--explain", str(why)]
    assert main(arguments) == 0
    (pose,) = json.loads(out.read_text())["poses"]
    assert (pose["found"], pose["state"], pose["covariance"]) == (True, "SUSPECT", None)
    assert pose["reason"] == "This method does not say how probable it is that a pose is right."
    assert np.abs(np.array(pose["T_cam_obj"]) - standing).max() < 0.05
    assert (why / "tea_box_pose.png").is_file()


@pytest.mark.parametrize("method", ["paper", "colorpair"])
def test_a_model_without_tables_says_what_adds_them(
    files: list[str], box: list[str], tea_box: ReferenceModel, tmp_path: Path, refused: Says, method: str
) -> None:
    save_model(replace(tea_box, tables=None), tmp_path / "tea_box.huepose")
    files = other(files, "--bundles", tmp_path)
    arguments = [*files, *box]
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((480, 640, 3), np.uint8))
    anywhere = other(files, "--color", tmp_path / "black.png")
    for asked in (arguments, anywhere):
        said = refused([*asked, "--method", method])
        assert "reference model 'tea_box': found no tables of the paper's method" in said
        assert "huepose onboard" in said
        assert "--paper" in said
    assert main(arguments) == 0


def test_nothing_in_the_box_is_an_answer(files: list[str], printed: Says) -> None:
    arguments = [*files, "--box", "0", "0", "4", "4"]
    (pose,) = json.loads(printed([*arguments, "--json"]))["poses"]
    assert (pose["found"], pose["T_cam_obj"], pose["state"]) == (False, None, "LOST")
    assert pose["reason"].endswith(".")
    assert printed(arguments).split() == f"not found: tea_box {pose['reason']}".split()


def test_a_reason_that_several_objects_share_is_printed_once() -> None:
    here = PoseEstimate("can", T_cam_obj=np.eye(4), quality=0.9, state=State.SUSPECT, reason="Half hidden.")
    gone = [PoseEstimate(name, reason=why) for name, why in [("a", "No."), ("b", "Why."), ("c", "No.")]]
    lines = in_words([gone[0], here, *gone[1:]]).splitlines()
    assert re.fullmatch(r"can +SUSPECT +quality 0\.90 .*", lines[0])
    assert lines[1:] == ["    Half hidden.", "not found: a, c", "    No.", "not found: b", "    Why."]


def test_without_json_an_answer_is_a_line(files: list[str], printed: Says) -> None:
    (line,) = printed(files).splitlines()
    assert re.fullmatch(
        r"tea_box +TRACKING +quality [01]\.\d\d( +[+-]\d\.\d{3}){3} m from the camera +\d+ ms", line
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--box", "1", "2", "0", "5"], "--box: found 1 2 0 5; expected X Y W H (left, top, width, height)"),
        (["--box", "nan", "2", "30", "50"], "--box: found nan 2 30 50"),
        (["--box", "5000", "2", "30", "50"], "and in the image of 640 x 480"),
        (["--box", "1", "2", "30", "50", "--object", "coffee"], "coffee"),
    ],
)
def test_bad_usage_exits_with_2_and_says_what_to_do(
    files: list[str], arguments: list[str], says: str, refused: Says
) -> None:
    assert says in refused([*files, *arguments])
