from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from huepose.model import load_models
from huepose.onboarding import read_mesh, simplify
from huepose_services.cli.main import main
from tests.onboarding import mesh_files as files
from tests.onboarding import solids


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    pictures = {s: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for s in solids.SIDES}
    files.write_glb(tmp_path / "brick.glb", solids.box((0.05, 0.04, 0.03), pictures))
    return tmp_path / "brick.glb"


def test_a_mesh_becomes_a_model(mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    declared = tmp_path / "symmetric.json"
    declared.write_text(json.dumps({"symmetries_continuous": [{"axis": [0, 0, 1]}]}))
    out = tmp_path / "bundles"
    arguments = ["onboard", "--no-test", str(mesh), "--name", "red_brick", "--id", "5", "--out", str(out)]
    assert main([*arguments, "--symmetric", str(declared)]) == 0
    line = capsys.readouterr().out
    assert line.startswith("red_brick")
    assert "5.0 x 4.0 x 3.0 cm" in line
    assert "72 look the same" in line
    model = load_models(out)["red_brick"]
    assert model.object_id == 5
    assert len(model.equivalents) == 72
    assert "tables" not in line
    assert model.tables is None


def test_a_model_gets_the_papers_tables_when_asked(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bundles"
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(out), "--paper"]) == 0
    assert "with the paper's tables" in capsys.readouterr().out
    tables = load_models(out)["brick"].tables
    assert tables is not None
    assert len(tables.cloud_points) > 0


def test_a_small_mesh_may_be_in_another_unit_and_that_can_be_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    pictures = {s: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for s in solids.SIDES}
    folder = tmp_path / "Körper mit Lücke"
    folder.mkdir()
    files.write_obj(folder / "brick ä.obj", solids.box((0.15, 0.08, 0.06), pictures), scale=100.0)
    arguments = [
        "onboard",
        "--no-test",
        str(folder / "brick ä.obj"),
        "--name",
        "brick",
        "--out",
        str(folder / "out"),
    ]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert "1.5 x 0.8 x 0.6 cm" in said.out
    assert "--unit cm" in said.err


def test_a_large_mesh_says_which_extra_it_needs(
    mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(simplify, "MOST", 11)  # the brick has twelve triangles
    monkeypatch.setitem(sys.modules, "open3d", None)  # as where it is not installed
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "this needs the Python package open3d; install it with: pip install 'huepose[onboard]'" in said
    assert not (tmp_path / "out").exists()


def test_bundles_go_into_a_folder(mesh: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(mesh)]) == 2
    assert "found a file; expected a folder" in capsys.readouterr().err


def test_ctrl_c_while_the_processes_start_ends_them_all(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pictures = {s: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for s in solids.SIDES}
    for number in (1, 2):
        files.write_obj(tmp_path / f"obj_{number:06d}.obj", solids.box((0.05, 0.04, 0.03), pictures))
    command = [sys.executable, "-m", "huepose_services.cli.main", "onboard-bop", str(tmp_path)]
    running = subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # what starts the tests may ignore it
    )
    assert running.stderr is not None
    assert "onboarding 2 objects" in running.stderr.readline()
    time.sleep(0.6)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does
    try:
        assert running.wait(60.0) == 130
    finally:
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
    with running.stderr:
        said = running.stderr.read()
    assert said.endswith("huepose onboard-bop: interrupted\n")
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--name", "Red Brick"], "object name 'Red Brick'"),
        (["--name", "brick", "--unit", "mm"], "Did you mean --unit m?"),
        (["--name", "brick", "--symmetric", "nowhere.json"], "nowhere.json: found no such file"),
    ],
)
def test_wrong_input_ends_with_2_and_a_fix(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], extra: list[str], message: str
) -> None:
    out = tmp_path / "bundles"
    assert main(["onboard", "--no-test", str(mesh), "--out", str(out), *extra]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_a_folder_without_meshes_ends_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["onboard-bop", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "no obj_NNNNNN.ply or .obj" in capsys.readouterr().err


def test_a_recording_takes_the_place_of_a_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("open3d")
    from huepose.datasets.bop_writer import BopWriter
    from huepose_services.cli import onboard
    from tests.onboarding.test_from_video import CAMERA, box_of, drawn, pose

    recording, out = tmp_path / "turned", tmp_path / "bundles"
    writer = BopWriter(recording, {})
    for k in range(3):
        frame = drawn(pose(np.radians(6.0 * k)), k)
        writer.add(k, frame.color, frame.depth, CAMERA, [])
    jobs = []

    def made(job: object, bundles: Path) -> None:
        jobs.append(job)
        raise KeyboardInterrupt

    monkeypatch.setattr(onboard, "onboard_one", made)
    box = [f"{x:.0f}" for x in box_of(pose(0.0)).box or ()]
    given = ["onboard", "--from-video", str(recording), "--box", *box, "--name", "tea", "--out", str(out)]
    main(given)
    assert [(job.mesh_path, job.unit) for job in jobs] == [(out / "tea_mesh" / "tea.obj", "m")]
    mesh = read_mesh(out / "tea_mesh" / "tea.obj", "m")
    assert 0.1 < np.ptp(mesh.vertices, axis=0).max() < 0.2


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "found neither MESH nor --from-video"),
        (["a.obj", "--from-video", "b.mcap"], "found MESH and --from-video"),
        (["--from-video", "b.mcap"], "found neither --box nor --click"),
        (["--from-video", "b.mcap", "--click", "1", "2", "--box", "1", "2", "3", "4"], "found both"),
        (["--from-video", "b.mcap", "--click", "1", "2"], "b.mcap: found No such file"),
    ],
)
def test_what_is_missing_for_a_recording_is_said(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["onboard", *given, "--name", "tea", "--out", str(tmp_path / "bundles")]) == 2
    assert said in capsys.readouterr().err
