"""The README's library example runs as it is written, on the frame that `huepose new tea_box` draws."""

import re
from pathlib import Path

import numpy as np

from huepose.geometry import se3
from huepose.model import save_model
from huepose.scenes.builtin import first_shot
from huepose.scenes.camera import CAMERA
from huepose_services.cli.new import write_frame

ROOT = Path(__file__).parents[1]


def test_the_library_example_finds_and_tracks_the_object(tea_box, tmp_path, monkeypatch, capsys):
    (tmp_path / "tea_box" / "bundles").mkdir(parents=True)
    save_model(tea_box, tmp_path / "tea_box" / "bundles" / "tea_box.huepose")
    shot = first_shot({"tea_box": tea_box.mesh})
    write_frame(tmp_path / "tea_box", shot, CAMERA)
    T_cam_obj = shot.labels.T_cam_obj[0]
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(code.strip().splitlines()) <= 11
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    assert capsys.readouterr().out.startswith("True ")
    assert names["pose"].state == "TRACKING"
    assert np.linalg.norm(names["pose"].T_cam_obj[:3, 3] - T_cam_obj[:3, 3]) < 0.002
    (tracked,) = names["tracker"].poses()
    assert tracked.state == "TRACKING"
    assert se3.rotation_angle(tracked.T_cam_obj, T_cam_obj) < np.radians(1.0)
