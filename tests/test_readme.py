"""The README's library example runs as it is written."""

import json
import re
from pathlib import Path

import cv2
import numpy as np

from huepose.geometry import Camera, se3
from huepose.model import save_model
from huepose.rendering.render import render

ROOT = Path(__file__).parents[1]


def test_the_library_example_finds_and_tracks_the_object(tea_box, tmp_path, monkeypatch, capsys):
    mesh = tea_box.mesh
    (tmp_path / "bundles").mkdir()
    save_model(tea_box, tmp_path / "bundles" / "tea_box.huepose")
    camera = Camera(600.0, 600.0, 319.5, 239.5, 640, 480)
    T_cam_obj = se3.make(
        se3.rotation_exp(np.array([1.7, 0.3, 0.2])),
        camera.backproject(np.array([447.0, 310.0]), np.array(0.8)),
    )
    picture = render([(mesh, T_cam_obj)], camera)
    rows, columns = np.nonzero(picture.depth)
    box = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
    cv2.imwrite(str(tmp_path / "color.png"), picture.color[..., ::-1])
    cv2.imwrite(str(tmp_path / "depth.png"), np.rint(picture.depth * 1000).astype(np.uint16))
    intrinsics = {"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}
    (tmp_path / "camera.json").write_text(json.dumps({**intrinsics, "depth_scale_m": 0.001}))
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(code.strip().splitlines()) <= 11
    code = code.replace("Box(410, 240, 75, 140)", f"Box{tuple(int(b) for b in box)}")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    assert capsys.readouterr().out.startswith("True ")
    assert np.linalg.norm(names["pose"].T_cam_obj[:3, 3] - T_cam_obj[:3, 3]) < 0.002
    (tracked,) = names["tracker"].poses()
    assert tracked.state == "TRACKING"
    assert se3.rotation_angle(tracked.T_cam_obj, T_cam_obj) < np.radians(1.0)
