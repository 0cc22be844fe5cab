"""`huepose eval pairs places` on sets of scenes: what a file of sets may say, and going on with a result."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from huepose.model import save_model
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose_services.cli.main import main


@pytest.fixture
def study(tmp_path: Path, tea_box: ReferenceModel, take_picture, standing: np.ndarray) -> list[str]:
    """The command; beside it a scene of one picture of the box, as BOP has it."""
    (tmp_path / "bundles").mkdir()
    save_model(replace(tea_box, object_id=1), tmp_path / "bundles" / "tea_box.huepose")
    frame, scene = take_picture([(tea_box.mesh, standing)]), tmp_path / "scenes" / "000007"
    camera = frame.camera
    for folder in ("rgb", "depth", "mask_visib"):
        (scene / folder).mkdir(parents=True)
    cv2.imwrite(str(scene / "rgb" / "000000.png"), cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR))
    cv2.imwrite(str(scene / "depth" / "000000.png"), np.rint(10000 * frame.depth).astype(np.uint16))
    mask = render_depth(tea_box.mesh, standing, camera) > 0
    cv2.imwrite(str(scene / "mask_visib" / "000000_000000.png"), 255 * mask.astype(np.uint8))
    K = [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]
    label = {
        "cam_R_m2c": standing[:3, :3].ravel().tolist(),
        "cam_t_m2c": (1000 * standing[:3, 3]).tolist(),
        "obj_id": 1,
    }
    texts = {"scene_camera": {"0": {"cam_K": K, "depth_scale": 0.1}}, "scene_gt": {"0": [label]}}
    for name, value in texts.items():
        (scene / f"{name}.json").write_text(json.dumps(value))
    words = ["eval", "pairs", "places", "--bundles", tmp_path / "bundles", "--json", tmp_path / "out.json"]
    return [*map(str, words), "--sets", str(tmp_path / "sets.yaml"), "--kinds", "edges"]


def test_a_file_of_sets_is_asked_once(study: list[str], tmp_path: Path, capsys) -> None:
    (tmp_path / "sets.yaml").write_text("table:\n  bop: [scenes/000007]\n  seeds: [0, 1]\n")
    assert main(study) == 0
    assert "-- table" in capsys.readouterr().out
    first = json.loads((tmp_path / "out.json").read_text())["places"]
    assert [q["seed"] for q in first["questions"]] == [0, 1]
    assert {f["place"] for f in first["figures"]} == {"as shipped", "no edges in the end", "no pairs at all"}
    assert main(study) == 0  # answers stay, to the very CPU time
    assert json.loads((tmp_path / "out.json").read_text())["places"] == first
    (tmp_path / "sets.yaml").write_text("shelf:\n  bop: [scenes/000007]\n")
    assert main(study) != 0
    assert "the set 'table'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [("table: {bob: [x]}", "'bob'"), ("table: {seeds: [0]}", "no 'bop'"), ("[x]", "no sets")],
)
def test_a_wrong_file_of_sets_is_named(
    study: list[str], tmp_path: Path, capsys, text: str, said: str
) -> None:
    (tmp_path / "sets.yaml").write_text(text)
    assert main(study) != 0
    assert said in capsys.readouterr().err
