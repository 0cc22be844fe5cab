from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose_services.cli.main import BAD_INPUT, DONE, main
from tests.services.conftest import Says


def test_scenes_of_the_builtin_objects_are_rendered_with_their_meshes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], refused: Says
) -> None:
    out = tmp_path / "heaps"
    arguments = ["render-scenes", "--models", "builtin", "--out", str(out), "--objects", "1", "2"]
    assert main([*arguments, "--frames", "1", "--seed", "3"]) == DONE
    assert "1 frame, 2 labels" in capsys.readouterr().out
    scene = BopScene(out)
    assert sorted(t.object_id or 0 for t in scene.truths(0)) == [1, 2]
    assert sorted(p.name for p in (out / "models").glob("*.obj")) == ["obj_000001.obj", "obj_000002.obj"]
    assert "rendered with other settings" in refused([*arguments, "--seed", "4"])
    assert main([*arguments, "--seed", "3", "--kind", "piles"]) == BAD_INPUT
    assert main(["render-scenes", "--models", "builtin", "--out", str(out), "--objects", "7"]) == BAD_INPUT
    assert main(["render-scenes", "--models", "builtin", "--out", str(out), "--frames", "0"]) == BAD_INPUT


def test_look_alikes_have_the_poses_of_the_objects_and_other_textures(tmp_path: Path) -> None:
    scenes = []
    for textures in ("0", "1"):
        out = tmp_path / textures
        command = ["render-scenes", "--models", "builtin", "--textures", textures, "--out", str(out)]
        assert main([*command, "--objects", "1", "--frames", "1", "--seed", "3"]) == DONE
        scenes.append(BopScene(out))
    (demo,), (alike,) = (scene.truths(0) for scene in scenes)
    assert demo.T_cam_obj == pytest.approx(alike.T_cam_obj)
    colors = [scene.frame(0).color[scene.truths(0)[0].mask()].astype(float) for scene in scenes]
    assert colors[0].shape == colors[1].shape
    assert np.abs(colors[0] - colors[1]).mean() > 20.0
