"""`huepose new`: from a mesh to a folder that `estimate` and a pipeline run on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.bop_writer import write_obj
from huepose.geometry import Mesh
from huepose.model import ReferenceModel, save_model
from huepose.onboarding import batch
from huepose.scenes.builtin import first_shot
from huepose_services.cli.main import main
from huepose_services.cli.new import _PIPELINE
from huepose_services.runtime.config_file import load
from tests.services.conftest import Says, heeds_ctrl_c


def test_a_mesh_becomes_a_folder_whose_frame_gives_its_pose(
    tea_box: ReferenceModel, tmp_path: Path, printed: Says, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its reference model is there already: test_cli_onboard onboards meshes."""

    def onboarded(mesh: Mesh, name: str, **_: object) -> ReferenceModel:
        np.testing.assert_allclose(mesh.vertices, tea_box.mesh.vertices, atol=1e-6)
        return replace(tea_box, mesh=mesh, name=name)

    monkeypatch.setattr(batch, "onboard_mesh", onboarded)
    write_obj(tmp_path / "box.obj", tea_box.mesh)
    out = tmp_path / "mine ä"
    said = printed(["new", "box", tmp_path / "box.obj", "--unit", "m", "--no-test", "--out", out])
    assert f"huepose demo --bundles '{out}/bundles'" in said
    assert f"--color '{out}/color.png' --depth" in said
    names = {"color": "color.png", "depth": "depth.png", "camera": "camera.json"}
    files = [word for key, name in names.items() for word in (f"--{key}", str(out / name))]
    assert main(["estimate", *files, "--bundles", str(out / "bundles"), "--json", str(out / "o.json")]) == 0
    (pose,) = json.loads((out / "o.json").read_text())["poses"]
    assert pose["state"] == "TRACKING"
    guide = Path(__file__).parents[2] / "docs" / "quickstart.md"
    assert (out / "camera.json").read_text() in guide.read_text()
    truth = first_shot({"box": tea_box.mesh}).labels
    assert truth.visib_fract[0] > 0.95
    assert np.abs(truth.T_cam_obj[0] - np.array(pose["T_cam_obj"])).max() < 0.005
    assert load(out / "pipeline.yaml").objects[0].name == "box"


@pytest.mark.parametrize("name", ["4711", "0123", "null", "on", "2026-11-30", "-"])
def test_a_name_that_yaml_reads_as_something_else_stays_a_name(name: str, tmp_path: Path) -> None:
    (tmp_path / "pipeline.yaml").write_text(_PIPELINE.format(name=name))
    assert load(tmp_path / "pipeline.yaml").objects[0].name == name


@pytest.mark.parametrize("name", ["pipeline.yaml", "color.png", "depth.png", "camera.json"])
def test_an_existing_file_is_not_changed(name: str, tmp_path: Path, refused: Says) -> None:
    """In the folder of the mesh, color.png may be its texture."""
    (tmp_path / name).write_text("site: mine\n")
    assert f"{name}: found a file that exists already" in refused(
        ["new", "box", "box.obj", "--out", tmp_path]
    )
    assert (tmp_path / name).read_text() == "site: mine\n"


def test_a_file_of_the_name_of_the_folder_is_refused_before_onboarding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("box").touch()
    assert main(["new", "box", "no_mesh.obj"]) == 2
    assert capsys.readouterr().err == "huepose new: box: found a file; expected a folder, which may be new.\n"


def test_a_mesh_that_is_too_large_to_be_rendered_is_refused_before_onboarding(
    tea_box: ReferenceModel, tmp_path: Path, refused: Says
) -> None:
    write_obj(tmp_path / "box.obj", replace(tea_box.mesh, vertices=tea_box.mesh.vertices * np.float32(10.0)))
    out = tmp_path / "mine"
    given = ["new", "box", str(tmp_path / "box.obj"), "--unit", "m", "--no-test", "--out", str(out)]
    said = refused(given)
    assert "found a largest side of 1.5 m" in said
    assert "give the mesh's unit" in said
    assert not out.exists()


def test_ctrl_c_ends_a_demo_whose_scene_is_still_being_rendered(
    tea_box: ReferenceModel, tmp_path: Path
) -> None:
    save_model(tea_box, tmp_path / "tea_box.huepose")
    seed = str(time.time_ns() % 10**9)  # of a scene that is not in the cache
    # As `huepose` does: with `-m`, Python ends by the signal itself if it comes while `exec` or `eval` of a
    # text runs, whatever the program does about it.
    start = "import sys; from huepose_services.cli.entry import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "demo", "--bundles", str(tmp_path), "--seed", seed]
    (tmp_path / "made").mkdir()
    with subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        env=os.environ | {"TMPDIR": str(tmp_path / "made")},
        text=True,
        preexec_fn=heeds_ctrl_c,
    ) as running:
        assert running.stderr is not None
        while f"rendering the scene of seed {seed}, once" not in (line := running.stderr.readline()):
            assert line, "it ended"
        running.send_signal(signal.SIGINT)
        said = running.stderr.read()
        assert running.wait(30.0) == 130
    assert said.endswith("huepose demo: interrupted\n")
    assert list((tmp_path / "made").glob("huepose-demo-*")) == []
