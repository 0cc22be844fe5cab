"""The README's library example runs as written, on the frame that `huepose new tea_box` renders."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.geometry import se3
from huepose.model import save_model
from huepose.scenes.builtin import first_shot
from huepose.scenes.camera import CAMERA
from huepose_services.cli.new import write_frame
from tests.meshes import demo_objects

ROOT = Path(__file__).parents[1]


@pytest.fixture
def example(tea_box, tmp_path, monkeypatch):
    """The example's code, run in a folder with the files that it reads, and the true pose."""
    (tmp_path / "tea_box" / "bundles").mkdir(parents=True)
    save_model(tea_box, tmp_path / "tea_box" / "bundles" / "tea_box.huepose")
    shot = first_shot({"tea_box": tea_box.mesh})
    write_frame(tmp_path / "tea_box", shot, CAMERA)
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(code.strip().splitlines()) <= 11
    monkeypatch.chdir(tmp_path)
    return code, shot.labels.T_cam_obj[0]


def test_the_library_example_finds_and_tracks_the_object(example, capsys):
    code, T_cam_obj = example
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    assert capsys.readouterr().out.startswith("True ")
    assert names["pose"].state == "TRACKING"
    assert np.linalg.norm(names["pose"].T_cam_obj[:3, 3] - T_cam_obj[:3, 3]) < 0.002
    (tracked,) = names["tracker"].poses()
    assert tracked.state == "TRACKING"
    assert se3.rotation_angle(tracked.T_cam_obj, T_cam_obj) < np.radians(1.0)


def test_a_look_alike_is_suspect_in_the_estimate_and_in_the_tracker(example):
    """The box of another seed: the same shape, another texture."""
    code, _ = example
    write_frame(Path("tea_box"), first_shot({"tea_box": demo_objects(1)["tea_box"]}), CAMERA)
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["pose"].state == "SUSPECT"
    (tracked,) = names["tracker"].poses()
    assert tracked.state == "SUSPECT"


def test_the_library_example_runs_if_no_pose_is_found(example, capsys):
    code, _ = example
    depth = cv2.imread("tea_box/depth.png", cv2.IMREAD_UNCHANGED)
    depth[:, :200] = 0
    cv2.imwrite("tea_box/depth.png", depth)
    exec(compile(code, "README.md", "exec"), {})
    found, tracked = capsys.readouterr().out.splitlines()
    assert found.startswith("False ")
    assert tracked == "[]"
