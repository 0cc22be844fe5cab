from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.evaluation import suitability
from huepose.model import load_models
from huepose.onboarding import batch, pairs, simplify
from huepose_services.cli.main import main
from huepose_services.cli.mesh_unit import with_unit
from tests import onboarded
from tests.onboarding import mesh_files as files
from tests.onboarding import solids
from tests.services.conftest import Says, heeds_ctrl_c


@pytest.fixture
def few_views(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(pairs, "LEVEL", 0)  # twelve sides for colour pairs, too
    with onboarded.few_views():
        yield


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    files.write_glb(tmp_path / "brick.glb", solids.printed_box((0.05, 0.04, 0.03)))
    return tmp_path / "brick.glb"


@pytest.mark.usefixtures("few_views")
def test_a_mesh_becomes_a_model(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "MANY_TRIANGLES", 12)  # all that the brick has
    declared = tmp_path / "symmetric.json"
    declared.write_text(json.dumps({"symmetries_continuous": [{"axis": [0, 0, 1]}]}))
    out = tmp_path / "bundles"
    arguments = ["onboard", "--no-test", str(mesh), "--name", "red_brick", "--id", "5", "--out", str(out)]
    assert main([*arguments, "--symmetric", str(declared)]) == 0
    line, said = capsys.readouterr()
    assert "simplifying" not in said
    assert line.startswith("red_brick")
    assert "5.0 x 4.0 x 3.0 cm" in line
    assert "72 rotations look the same" in line
    model = load_models(out)["red_brick"]
    assert model.object_id == 5
    assert len(model.equivalents) == 72
    assert "tables" not in line
    assert model.tables is None


@pytest.mark.usefixtures("few_views")
def test_a_model_gets_the_requested_tables_and_a_long_simplification_is_announced(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch, "MANY_TRIANGLES", 11)
    out = tmp_path / "bundles"
    arguments = ["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(out)]
    assert main([*arguments, "--symmetric", "y", "--paper"]) == 0
    line, said = capsys.readouterr()
    assert "2 rotations look the same" in line
    assert "with the paper's tables" in line
    assert "simplifying 12 triangles, which may take minutes" in said
    model = load_models(out)["brick"]
    np.testing.assert_allclose(np.diag(model.equivalents[1]), [-1.0, 1.0, -1.0, 1.0], atol=1e-3)
    assert model.tables is not None
    assert len(model.tables.cloud_points) > 0


@pytest.mark.usefixtures("few_views", "onboards_here")
def test_onboarding_a_folder_names_replaced_models_and_deletes_their_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files.write_obj(tmp_path / "obj_000001.obj", solids.printed_box((0.05, 0.04, 0.03)))
    out = tmp_path / "bundles"
    one = [str(tmp_path / "obj_000001.obj"), "--name", "obj_000001", "--id", "1", "--unit", "mm"]
    assert main(["onboard", "--no-test", *one, "--symmetric", "z", "--out", str(out)]) == 0
    verdict_files = [out / "obj_000001.verdict.json", out / "obj_000001.verdict.png"]
    for path in verdict_files:
        path.write_text("of the model before")
    capsys.readouterr()
    many = ["onboard-bop", str(tmp_path), "--out", str(out), "--processes", "1"]
    assert main(many) == 0
    said = capsys.readouterr().err
    assert f"note: {out / 'obj_000001.huepose'} replaced another reference model named obj_000001" in said
    assert "To have both, onboard these into another folder, --out\n" in said
    assert said.count("replaced") == 1
    assert not any(path.exists() for path in verdict_files)
    for path in verdict_files:
        path.write_text("of this model")
    assert main(many) == 0
    assert "replaced" not in capsys.readouterr().err, "the same models again"
    assert all(path.exists() for path in verdict_files)


@pytest.mark.usefixtures("few_views")
def test_validate_repeats_the_verdict_on_an_object_until_another_model_of_its_name_replaces_it(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, printed
) -> None:
    monkeypatch.setattr(suitability, "self_test", partial(suitability.self_test, count=4))
    out, plain, pipeline = tmp_path / "bundles", tmp_path / "plain.glb", tmp_path / "pipeline.yaml"
    red = solids.plain((200, 40, 30))
    files.write_glb(plain, solids.box((0.05, 0.04, 0.03), dict.fromkeys(solids.SIDES, red)))
    pipeline.write_text(json.dumps({"bundles": "bundles", "objects": [{"name": "brick"}]}))
    given = ["--name", "brick", "--out", str(out)]
    out.mkdir()
    (out / "brick.png").write_text("the texture of a mesh in this folder")
    lines = printed(["onboard", plain, *given]).splitlines()
    verdict = next(line for line in lines if "rendered scenes" in line)
    assert verdict.startswith(("brick suits with limits: ", "brick does not suit: "))
    assert f"\n  NOTE     {verdict}\n" in printed(["validate", pipeline])
    assert main(["onboard", "--no-test", str(plain), *given]) == 0
    assert (out / "brick.verdict.png").exists(), "the same model"
    assert "replaced" not in capsys.readouterr().err
    assert main(["onboard", "--no-test", str(mesh), *given]) == 0  # another model: nothing is known of it
    assert sorted(path.name for path in out.iterdir()) == ["brick.huepose", "brick.png"]
    assert (out / "brick.png").read_text() == "the texture of a mesh in this folder"
    said = capsys.readouterr().err
    assert f"note: {out / 'brick.huepose'} replaced another reference model named brick, made on " in said
    assert said.count("replaced") == 1
    assert "NOTE" not in printed(["validate", pipeline])


@pytest.fixture
def centimetres(tmp_path: Path) -> Path:
    """A brick of 15 cm in centimetres, in a file and a folder whose names have blanks and umlauts."""
    folder = tmp_path / "Körper mit Lücke"
    folder.mkdir()
    files.write_obj(folder / "brick ä.obj", solids.printed_box((0.15, 0.08, 0.06)), scale=100.0)
    return folder / "brick ä.obj"


@pytest.mark.parametrize("verb", ["onboard", "new"])
def test_a_script_must_give_the_unit_of_a_mesh(
    centimetres: Path, tmp_path: Path, refused: Says, verb: str
) -> None:
    out = tmp_path / "out"
    given = ["new", "brick", str(centimetres)]
    if verb == "onboard":
        given = ["onboard", str(centimetres), "--name", "brick"]
    said = " ".join(refused([*given, "--no-test", "--out", out]).split())
    sizes = "1.5 cm in millimetres, 15 cm in centimetres, 38.1 cm in inches"
    assert f"found no unit, and a largest side of {sizes}" in said
    assert said.endswith("Give it: --unit mm|cm|in.")
    assert not out.exists()


@pytest.mark.usefixtures("few_views")
def test_at_a_terminal_the_unit_is_asked_for_before_onboarding(
    centimetres: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["\n", "furlong\n", "CM\n"])
    terminal = SimpleNamespace(isatty=lambda: True, readline=lambda: next(answers))
    monkeypatch.setattr(sys, "stdin", terminal)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    arguments = ["onboard", "--no-test", str(centimetres), "--name", "brick", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert said.err.count("In which unit is it, mm, cm, in? ") == 3
    assert "15.0 x 8.0 x 6.0 cm" in said.out


def test_a_usual_size_is_accepted_and_printed_with_the_alternatives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((0.12, 0.08, 0.06)), scale=1000.0)
    files.write_glb(tmp_path / "m.glb", solids.box((0.12, 0.08, 0.06)))
    files.write_glb(tmp_path / "l.glb", solids.box((1.2, 0.8, 0.6)))
    settled = {name: with_unit(batch.Job(tmp_path / name, "m")).unit for name in ("m.obj", "m.glb", "l.glb")}
    assert settled == {"m.obj": "mm", "m.glb": "m", "l.glb": "m"}
    first, second = capsys.readouterr().err.splitlines()
    assert first == (
        "note: the mesh gives no unit, and is read in millimetres: its largest side is 12 cm (it would be "
        "1.2 m in centimetres). If this is wrong, give the unit with --unit."
    )
    assert second.startswith("note: a .glb file is read in metres: its largest side is 1.2 m")
    assert "36.58 cm in feet" in second


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (
            1000.0,
            "1.2 m with --unit cm: too large for rendered scenes (at most 45 cm); it would be 12 cm in "
            "millimetres",
        ),
        (20.0, "2.4 cm with --unit cm; it would be 6.096 cm in inches or 73.15 cm in feet"),
        (100.0, ""),
    ],
)
def test_a_unit_that_gives_an_unusual_size_causes_a_warning_before_onboarding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float, said: str
) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((0.12, 0.08, 0.06)), scale=scale)
    assert with_unit(batch.Job(tmp_path / "m.obj", "m", unit="cm")).unit == "cm"
    assert capsys.readouterr().err == (f"warning: its largest side is {said}\n" if said else "")


@pytest.mark.usefixtures("few_views")
def test_the_warning_of_an_unusual_size_comes_first_and_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Long and slender: the views of a large object take long to render.
    files.write_obj(tmp_path / "m.obj", solids.printed_box((0.048, 0.004, 0.004)), scale=1000.0)
    given = [str(tmp_path / "m.obj"), "--unit", "cm", "--out", str(tmp_path / "out")]
    assert main(["onboard", *given, "--name", "brick"]) == 0
    first, *rest = capsys.readouterr().err.splitlines()
    assert first.startswith(
        "warning: its largest side is 48 cm with --unit cm: too large for rendered scenes"
    )
    assert not [line for line in rest if line.startswith("warning")]
    assert rest[-1].startswith(
        "brick was not tested in rendered scenes: object 'brick': found a largest side"
    )
    assert rest[-1].endswith("(--unit).")


def test_a_large_mesh_says_which_extra_it_needs(
    mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Says
) -> None:
    monkeypatch.setattr(simplify, "MAX_TRIANGLES", 11)  # the brick has twelve triangles
    monkeypatch.setitem(sys.modules, "open3d", None)  # as if it were not installed
    said = refused(["onboard", "--no-test", mesh, "--name", "brick", "--out", tmp_path / "out"])
    assert "this needs the Python package open3d; install it with: pip install" in said
    assert "[onboard]'" in said
    assert not (tmp_path / "out").exists()


def test_bundles_go_into_a_folder(mesh: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(mesh)]) == 2
    assert "found a file; expected a folder" in capsys.readouterr().err


def test_ctrl_c_while_the_processes_start_ends_them_all(tmp_path: Path) -> None:
    for number in (1, 2):
        files.write_obj(tmp_path / f"obj_{number:06d}.obj", solids.printed_box((0.05, 0.04, 0.03)))
    command = [sys.executable, "-m", "huepose_services.cli.main", "onboard-bop", str(tmp_path)]
    running = subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=heeds_ctrl_c,
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
        (["--name", "brick", "--unit", "mm"], "Did you mean --unit m or --unit ft?"),
        (["--name", "brick", "--symmetric", "nowhere.json"], "nowhere.json: found no such file"),
        (["--name", "brick", "--symmetric", "q"], "Give an axis of the mesh, x, y or z, or such a file."),
    ],
)
def test_wrong_input_ends_with_2_and_a_fix(
    mesh: Path, tmp_path: Path, refused: Says, extra: list[str], message: str
) -> None:
    out = tmp_path / "bundles"
    assert message in refused(["onboard", "--no-test", mesh, "--out", out, *extra])
    assert not out.exists()


@pytest.mark.parametrize(
    ("inside", "fix"), [("brick.glb", "Did you mean {}?"), ("", "this folder has none.")]
)
def test_a_folder_instead_of_a_mesh_is_refused(
    mesh: Path, tmp_path: Path, refused: Says, inside: str, fix: str
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    if inside:
        mesh.rename(folder / inside)
    said = refused(["onboard", folder, "--name", "brick", "--out", tmp_path / "out"])
    assert f"{folder}: found a folder; expected a mesh file: .obj, .ply, .glb, .gltf." in said
    assert said.endswith(fix.format(folder / inside) + "\n")


def test_meshes_of_a_folder_that_are_not_onboarded_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("huepose_services.cli.onboard.onboard_models", lambda *given: [])
    for name in ("obj_000001.ply", "obj_000001.obj", "Tuna can.obj", "obj_000002.PLY", "obj_000001.png"):
        (tmp_path / name).touch()
    assert main(["onboard-bop", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    why = "not onboarded, because the name is not obj_NNNNNN.ply or .obj"
    assert said == f"note: {why}: Tuna can.obj, obj_000002.PLY\n"


@pytest.mark.parametrize("processes", ["0", "-1"])
def test_a_folder_is_onboarded_by_one_process_or_more(tmp_path: Path, refused: Says, processes: str) -> None:
    command = ["onboard-bop", str(tmp_path), "--out", str(tmp_path / "out"), "--processes", processes]
    said = f"argument --processes: found {processes}, expected a whole number, 1 or more\n"
    assert said in refused(command)


def test_a_folder_without_meshes_ends_with_2(tmp_path: Path, refused: Says) -> None:
    assert "no obj_NNNNNN.ply or .obj" in refused(["onboard-bop", tmp_path, "--out", tmp_path / "out"])
