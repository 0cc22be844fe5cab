"""`huepose eval` from the command line, on a scene of two frames."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.estimation import EstimatorConfig
from huepose.evaluation import measured, states
from huepose.geometry import se3
from huepose.model import save_model
from huepose.support.errors import InputError
from huepose_services.cli import evaluate_estimate, evaluate_track
from huepose_services.cli.evaluate_perception import _report
from huepose_services.cli.evaluate_scenes import open_bop, states_line
from huepose_services.cli.main import main
from huepose_services.cli.pose_tables import PoseSources
from tests.evaluation.conftest import reference_model
from tests.evaluation.results import write_track
from tests.services.conftest import Says

T_CAM_OBJ = se3.make(se3.rotation_exp([0.3, 0.2, 0.1]), [0.02, 0.01, 0.6])


@pytest.fixture
def bundles(tmp_path: Path) -> Path:
    folder = tmp_path / "bundles"
    folder.mkdir()
    save_model(reference_model("wedge", 5), folder / "wedge.huepose")
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "000009"
    label = {
        "cam_R_m2c": T_CAM_OBJ[:3, :3].ravel().tolist(),
        "cam_t_m2c": (1000 * T_CAM_OBJ[:3, 3]).tolist(),
        "obj_id": 5,
    }
    for kind, image in (
        ("rgb", np.zeros((48, 64, 3), np.uint8)),
        ("depth", np.full((48, 64), 900, np.uint16)),
    ):
        (folder / kind).mkdir(parents=True)
        for n in range(2):
            cv2.imwrite(str(folder / kind / f"{n:06d}.png"), image)
    camera = {"cam_K": [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1], "depth_scale": 1.0}
    (folder / "scene_camera.json").write_text(json.dumps({0: camera, 1: camera}))
    (folder / "scene_gt.json").write_text(json.dumps({0: [label], 1: [label]}))
    return folder


@pytest.fixture
def scoring(bundles: Path, scene: Path, tmp_path: Path) -> list[str]:
    """The command that scores one message into result.json."""
    message = {
        "object": "wedge", "instance": 0, "camera_epoch": 1, "frame_id": 1, "capture_ns": 10,
        "publish_ns": 5_000_010, "state": "TRACKING", "quality": 0.9,
        "translation": (T_CAM_OBJ[:3, 3] + [0.01, 0, 0]).tolist(),
        "quaternion": se3.quaternion_from_rotation(T_CAM_OBJ[:3, :3]).tolist(),
    }  # fmt: skip
    poses, result = tmp_path / "poses.jsonl", tmp_path / "result.json"
    poses.write_text(json.dumps(message) + "\n")
    command = ["eval", "poses", poses, "--bop", scene, "--bundles", bundles, "--json", result]
    return [str(word) for word in command]


def test_poses_of_a_live_run_are_scored(scoring: list[str], tmp_path: Path, capsys) -> None:
    assert main(scoring) == 0
    record = json.loads((tmp_path / "result.json").read_text())
    assert record["summary"]["recall_add"] == 50.0
    assert record["rows"][1]["add_m"] == pytest.approx(0.01)
    assert record["rows"][0]["T_cam_obj"] is None
    assert "50.0 % of frames" in (said := capsys.readouterr().out)
    assert "first pass" not in said
    page = tmp_path / "page.md"
    assert main(["eval", "results", str(tmp_path / "result.json"), "--out", str(page)]) == 0
    assert "| all frames | 2 | 50.0 |" in page.read_text()


def test_the_output_says_that_only_the_first_of_several_passes_counts(
    scoring: list[str], tmp_path: Path, capsys
) -> None:
    (message,) = (tmp_path / "poses.jsonl").read_text().splitlines()
    later = [{**json.loads(message), "frame_id": 2 * n + 1, "capture_ns": n * 10**9} for n in (1, 2)]
    with (tmp_path / "poses.jsonl").open("a") as poses:
        poses.writelines(json.dumps(one) + "\n" for one in later)
    assert main(scoring) == 0
    said = "only the first pass of the scene counts: 1 of 3 messages belong to it"
    assert said in capsys.readouterr().out


def test_the_output_says_that_the_poses_are_of_more_than_the_scene(
    scoring: list[str], scene: Path, tmp_path: Path, capsys
) -> None:
    """They began before the scene and ended after it: that is no second pass."""
    (scene / "rgb" / "000000.png").unlink()
    (message,) = (tmp_path / "poses.jsonl").read_text().splitlines()
    more = [{**json.loads(message), "frame_id": n, "capture_ns": 9 + n} for n in (0, 7)]
    with (tmp_path / "poses.jsonl").open("a") as poses:
        poses.writelines(json.dumps(one) + "\n" for one in more)
    assert main(scoring) == 0
    said = capsys.readouterr().out
    assert "the scene is only a part of what was played: 1 of 3 messages belong to it" in said
    assert "first pass" not in said


def test_a_scene_whose_objects_are_all_occluded_is_scored(
    scoring: list[str], scene: Path, tmp_path: Path, printed: Says
) -> None:
    occluded = [{"visib_fract": 0.05, "bbox_visib": [0, 0, 2, 2]}]
    (scene / "scene_gt_info.json").write_text(json.dumps({0: occluded, 1: occluded}))
    assert "poses for - of frames" in printed(scoring)
    assert json.loads((tmp_path / "result.json").read_text())["summary"]["poses_for_frames"] is None


def test_poses_are_read_from_all_listed_paths(tmp_path: Path) -> None:
    sources, name = PoseSources({}, EstimatorConfig()), "006_mustard_bottle"
    with pytest.raises(InputError) as error:
        sources.of(str(tmp_path), name, 0)
    paths = re.findall(rf"{name}\S*\.(?:csv|txt)", str(error.value))
    assert len(paths) == 4
    for path in paths:
        folder = tmp_path / path.replace("/", "_")
        (folder / path).parent.mkdir(parents=True)
        (folder / path).write_text("nonsense\n")
        with pytest.raises(InputError, match="line 1"):
            sources.of(str(folder), name, 0)
    (tmp_path / f"{name}.txt").write_text("0 0 1 0 0 1 0\n")
    with pytest.raises(InputError, match="no poses of sequence"):
        sources.of(str(tmp_path), name, 0)


@pytest.mark.parametrize("closed", [["stdout"], ["stderr"], ["stdout", "stderr"]])
def test_results_are_written_even_if_nobody_reads_the_output(
    scoring: list[str], tmp_path: Path, closed: list[str]
) -> None:
    """Here Python writes each word at once, otherwise when its buffer is full."""
    read_end, write_end = os.pipe()
    os.close(read_end)
    outputs = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | dict.fromkeys(closed, write_end)
    command = [sys.executable, "-u", "-m", "huepose_services.cli.main", *scoring]
    ended = subprocess.run(command, text=True, check=False, **outputs)
    os.close(write_end)
    assert ended.returncode == 0
    assert "Error" not in (ended.stderr or "")
    assert json.loads((tmp_path / "result.json").read_text())["summary"]["recall_add"] == 50.0


@pytest.mark.parametrize(
    ("extra", "named"), [(["--objects", "7"], "Onboard"), (["--equivalent", "nowhere.json"], "nowhere.json")]
)
def test_wrong_input_ends_with_2_and_says_what_to_do(
    bundles: Path, scene: Path, tmp_path: Path, refused, extra: list[str], named: str
) -> None:
    result = tmp_path / "result.json"
    command = ["eval", "estimate", "--bop", str(scene), "--bundles", str(bundles), "--json", str(result)]
    assert named in refused([*command, *extra])
    assert not result.exists()


def test_the_output_says_how_many_objects_were_never_confirmed(tmp_path: Path) -> None:
    """Coverage counts from confirmation on, so it does not show these."""
    written = [
        json.loads(write_track(tmp_path / "a.json", [True] * 9, [state] * 9).read_text())
        for state in ("TRACKING", "SUSPECT")
    ]
    moments = [[measured._moment(row) for row in record["rows"]] for record in written]
    both = states.combined([states.report(own) for own in moments])
    summary = {**vars(both), "coverage_tracking": both.coverage_tracking, "false_tracking_rate": 0.0}
    said = "TRACKING in 100.0 % of visible frames from confirmation on"
    assert said in (line := states_line(summary))
    assert "confirmed after 0.00 s (never: 1)" in line
    assert "never" not in states_line({**summary, "never_confirmed": 0})


@pytest.mark.parametrize(
    ("module", "options"), [(evaluate_estimate, "EstimateOptions"), (evaluate_track, "TrackOptions")]
)
def test_a_seed_that_is_given_twice_counts_once(
    module, options: str, bundles: Path, scene: Path, tmp_path: Path, refused, monkeypatch
) -> None:
    """Otherwise n would be twice the number of instances."""

    def stop(*given: object) -> None:
        raise InputError(f"seeds {[value for value in given if isinstance(value, tuple)]}")

    monkeypatch.setattr(module, options, stop)
    verb = module.__name__.rpartition("_")[2]
    words = ["eval", verb, "--bop", scene, "--bundles", bundles, "--json", tmp_path / "r", "--seed", 3, 0, 3]
    assert "seeds [(3, 0)]" in refused(words)


def test_boxes_of_a_file_need_scenes_named_by_a_number(
    bundles: Path, scene: Path, tmp_path: Path, refused
) -> None:
    """Otherwise no box of the file would belong to any scene, and every label would be missed."""
    boxes = tmp_path / "boxes.json"
    found = {"scene_id": 9, "image_id": 0, "category_id": 5, "bbox": [20, 15, 20, 20], "score": 0.9}
    boxes.write_text(json.dumps([found]))
    named = scene.rename(tmp_path / "heaps")
    words = ["eval", "estimate", "--bundles", bundles, "--boxes", boxes, "--json", tmp_path / "r"]
    assert "scenes whose name is no number (heaps)" in refused([*words, "--bop", named])


def test_a_scene_without_labels_is_named(bundles: Path, scene: Path, tmp_path: Path, refused) -> None:
    (scene / "scene_gt.json").unlink()
    command = f"eval estimate --bop {scene} --bundles {bundles} --json {tmp_path / 'r'}".split()
    assert "scene_gt.json" in refused(command)


def test_a_scene_that_is_given_twice_is_named_as_it_was_given(
    scene: Path, bundles: Path, tmp_path: Path, refused
) -> None:
    words = ["eval", "estimate", "--bundles", bundles, "--json", tmp_path / "r", "--bop", scene]
    again = scene.parent / "." / scene.name
    assert f"scene {scene}: found the same folder twice; expected each folder once." in refused(
        [*words, again]
    )


def test_scenes_of_several_sets_may_have_one_name(
    scene: Path, bundles: Path, tmp_path: Path, refused
) -> None:
    """The results also name the set; declared equivalents name only the scene, so they are refused."""
    other = shutil.copytree(scene, tmp_path / "other" / scene.name)
    assert [one.name for one in open_bop([scene, other])] == [f"{tmp_path.name}-000009", "other-000009"]
    given = tmp_path / "given.json"
    given.write_text(json.dumps({"000009/0/0": {"object": 5, "why": "", "T_obj_obj": [np.eye(4).tolist()]}}))
    words = [
        "eval",
        "estimate",
        "--bundles",
        bundles,
        "--equivalent",
        given,
        "--json",
        given,
        "--bop",
        scene,
        other,
    ]
    assert "scenes of several sets with one name" in refused(words)


@pytest.mark.parametrize("others", [{}, {"carton": 2}])
def test_the_report_names_what_false_boxes_show_if_there_are_any(others: dict[str, int]) -> None:
    ious = {"mask_iou": 0.9, "final_mask_iou": None}
    block = {"instances": 3, "recall_iou50": 100.0, "recall_at": {1: 100.0}, "false_boxes": 2} | ious
    summary = block | {
        "per_object": {"wedge": block},
        "false_boxes_per_frame": 1.0,
        "confusion": {"wedge": {"wedge": 3} | others},
        "interval95": {"recall_iou50": [90.0, 100.0], "false_boxes_per_frame": [0.0, 1.0]},
        "profile": "live",
        "frames": 2,
        "asked_for": 1,
        "detector_seconds_per_frame_p50": 0.1,
        "seconds_per_frame_p50": 0.2,
    }
    text = _report(summary)
    assert ("false boxes, by what is really there:\n  wedge: carton 2" in text) == bool(others), text
    assert ("false boxes" in text) == bool(others), text
