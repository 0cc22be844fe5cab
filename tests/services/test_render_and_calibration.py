import json
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.bop import BopScene
from huepose_services.cli.main import BAD_INPUT, DONE, main

TERMS = {
    "total": 1.5, "gaps": [0.1], "color": 0.4, "box_iou": 0.8, "depth_fit": 0.7, "coverage": 0.7,
    "violation": 0.1, "occluded": 0.1, "seen": 0.7,
    "missing": 0.2, "foreign": 10.0, "detail": 0.4, "scale_residual": 0.0, "pixels": 2000.0,
    "turned": 0.0, "otherwise": 0.1, "agreed": 1.0,
}  # fmt: skip


def test_scenes_of_the_builtin_objects_are_drawn_with_their_meshes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "heaps"
    arguments = ["render-scenes", "--models", "builtin", "--out", str(out), "--objects", "1", "2"]
    assert main([*arguments, "--frames", "1", "--seed", "3"]) == DONE
    assert "1 frame, 2 labels" in capsys.readouterr().out
    scene = BopScene(out)
    assert sorted(t.object_id or 0 for t in scene.truths(0)) == [1, 2]
    assert sorted(p.name for p in (out / "models").glob("*.obj")) == ["obj_000001.obj", "obj_000002.obj"]
    assert main([*arguments, "--seed", "4"]) == BAD_INPUT
    assert "drawn with other settings" in capsys.readouterr().err
    assert main([*arguments, "--seed", "3", "--kind", "piles"]) == BAD_INPUT
    assert main(["render-scenes", "--models", "builtin", "--out", str(out), "--objects", "7"]) == BAD_INPUT
    assert main(["render-scenes", "--models", "builtin", "--out", str(out), "--frames", "0"]) == BAD_INPUT


def test_look_alikes_stand_where_the_objects_would_in_other_textures(tmp_path: Path) -> None:
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


def _results(path: Path, n: int, seed: int, overstated: float = 0.0) -> Path:
    """A result file in which a pose is right with the chance that its quality says, less `overstated`."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(n):
        quality = float(rng.uniform(0.3, 1.0))
        place = {"scene": "s", "image": k, "instance": 0, "found": True, "adds_m": 0.0, "diameter_m": 0.2}
        right = bool(rng.random() < quality - overstated)
        rows.append({**place, "quality": quality, "right": right, "terms": TERMS})
    path.write_text(json.dumps({"rows": rows, "false": []}))
    return path


def test_true_quality_errs_by_chance_alone_and_overstated_quality_by_what_it_overstates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    true = _results(tmp_path / "true.json", 3000, 0)
    bold = _results(tmp_path / "bold.json", 3000, 1, overstated=0.2)
    assert main(["eval", "calibration", str(true), str(bold), "--plots", str(tmp_path)]) == DONE
    fields = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines()}
    error, at_most_by_chance = float(fields["true"][3]), float(fields["true"][6])
    assert error < 1.5 * at_most_by_chance
    assert float(fields["bold"][3]) == pytest.approx(0.2, abs=0.02)
    assert (tmp_path / "reliability_true.png").stat().st_size > 0


def test_results_of_one_name_are_told_apart_by_their_folders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [tmp_path / folder / "heaps.json" for folder in ("before", "after")]
    for seed, path in enumerate(paths):
        path.parent.mkdir()
        _results(path, 50, seed)
    command = ["eval", "calibration", *map(str, paths), "--plots", str(tmp_path)]
    assert main(command) == DONE
    said = capsys.readouterr().out
    for name in ("before-heaps", "after-heaps"):
        assert name in said
        assert (tmp_path / f"reliability_{name}.png").exists()


def test_results_without_terms_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "old.json"
    row = {"scene": "s", "image": 0, "found": True, "right": True, "quality": 0.5}
    path.write_text(json.dumps({"rows": [row]}))
    assert main(["eval", "calibration", str(path)]) == BAD_INPUT
    assert "Make it again" in capsys.readouterr().err
