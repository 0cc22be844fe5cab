from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from huepose.datasets.bop_writer import BopWriter
from huepose.geometry import RgbdFrame
from huepose.model import load_models
from huepose.onboarding import read_mesh, simplify
from huepose.onboarding.batch import Job
from huepose_protos.buffers import pack
from huepose_protos.messages import FrameHeader, PoseMessage
from huepose_services.cli.main import main
from huepose_services.cli.mesh_unit import with_unit
from huepose_services.convert import depth_to_wire, intrinsics_to_wire
from tests.onboarding import mesh_files as files
from tests.onboarding import solids
from tests.services.recording.conftest import EXAMPLES, KEY, parts


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
    assert "72 rotations look the same" in line
    model = load_models(out)["red_brick"]
    assert model.object_id == 5
    assert len(model.equivalents) == 72
    assert "tables" not in line
    assert model.tables is None


def test_a_model_that_replaces_another_of_its_name_says_so(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bundles"
    other, black = tmp_path / "other.glb", np.zeros((64, 64, 3), np.uint8)
    files.write_glb(other, solids.box((0.06, 0.04, 0.03), dict.fromkeys(solids.SIDES, black)))

    def onboard(one: Path) -> int:
        return main(["onboard", "--no-test", str(one), "--name", "brick", "--out", str(out)])

    assert onboard(mesh) == onboard(mesh) == 0
    assert "replaced" not in capsys.readouterr().err  # the same model again
    assert onboard(other) == 0
    said = capsys.readouterr().err
    assert f"note: {out / 'brick.huepose'} replaced another reference model named brick, made on " in said
    assert said.count("replaced") == 1


def test_a_model_gets_the_papers_tables_when_asked(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bundles"
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(out), "--paper"]) == 0
    assert "with the paper's tables" in capsys.readouterr().out
    tables = load_models(out)["brick"].tables
    assert tables is not None
    assert len(tables.cloud_points) > 0


@pytest.fixture
def centimetres(tmp_path: Path) -> Path:
    """A brick of 15 cm whose numbers are centimetres, in a file and a folder with names of people."""
    rng = np.random.default_rng(0)
    pictures = {s: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for s in solids.SIDES}
    folder = tmp_path / "Körper mit Lücke"
    folder.mkdir()
    files.write_obj(folder / "brick ä.obj", solids.box((0.15, 0.08, 0.06), pictures), scale=100.0)
    return folder / "brick ä.obj"


@pytest.mark.parametrize("verb", ["onboard", "new"])
def test_nothing_is_learnt_of_a_mesh_whose_unit_a_script_does_not_say(
    centimetres: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str
) -> None:
    out = tmp_path / "out"
    given = ["new", "brick", str(centimetres)]
    if verb == "onboard":
        given = ["onboard", str(centimetres), "--name", "brick"]
    assert main([*given, "--no-test", "--out", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    sizes = "1.5 cm in millimetres, 15 cm in centimetres, 38.1 cm in inches"
    assert f"found no unit, and a largest side of {sizes}" in said
    assert said.endswith("Say it: --unit mm|cm|in.")
    assert not out.exists()


def test_at_a_terminal_the_unit_is_asked_for_before_anything_is_learnt(
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


def test_a_usual_size_is_taken_and_said_with_the_others_that_it_could_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((0.12, 0.08, 0.06)), scale=1000.0)
    files.write_glb(tmp_path / "m.glb", solids.box((0.12, 0.08, 0.06)))
    files.write_glb(tmp_path / "l.glb", solids.box((1.2, 0.8, 0.6)))
    settled = {name: with_unit(Job(tmp_path / name, "m")).unit for name in ("m.obj", "m.glb", "l.glb")}
    assert settled == {"m.obj": "mm", "m.glb": "m", "l.glb": "m"}
    first, second = capsys.readouterr().err.splitlines()
    assert first == (
        "note: the mesh gives no unit; its largest side is taken as 12 cm in millimetres (it would be 1.2 m "
        "in centimetres); --unit says another"
    )
    assert second.startswith(
        "note: the mesh is in metres as all of its format: its largest side is 1.2 m in metres"
    )


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        (
            1000.0,
            "1.2 m with --unit cm: larger than drawn scenes hold (45 cm); it would be 12 cm in millimetres",
        ),
        (20.0, "2.4 cm with --unit cm; it would be 6.096 cm in inches"),
        (100.0, ""),
    ],
)
def test_of_a_unit_that_makes_an_unusual_size_it_is_warned_before_anything_is_learnt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float, said: str
) -> None:
    files.write_obj(tmp_path / "m.obj", solids.box((0.12, 0.08, 0.06)), scale=scale)
    assert with_unit(Job(tmp_path / "m.obj", "m", unit="cm")).unit == "cm"
    assert capsys.readouterr().err == (f"warning: its largest side is {said}\n" if said else "")


def test_the_warning_of_an_unusual_size_comes_first_and_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    pictures = {s: rng.integers(0, 256, (64, 64, 3)).astype(np.uint8) for s in solids.SIDES}
    files.write_obj(tmp_path / "m.obj", solids.box((0.06, 0.04, 0.03), pictures), scale=1000.0)
    given = [str(tmp_path / "m.obj"), "--unit", "cm", "--out", str(tmp_path / "out")]
    assert main(["onboard", *given, "--name", "brick"]) == 0
    first, *rest = capsys.readouterr().err.splitlines()
    assert first.startswith("warning: its largest side is 60 cm with --unit cm: larger than drawn scenes")
    assert not [line for line in rest if line.startswith("warning")]
    assert rest[-1].startswith("brick was not tried in drawn scenes: object 'brick': found a largest side")
    assert rest[-1].endswith("(--unit).")


def test_a_large_mesh_says_which_extra_it_needs(
    mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(simplify, "MAX_TRIANGLES", 11)  # the brick has twelve triangles
    monkeypatch.setitem(sys.modules, "open3d", None)  # as where it is not installed
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "this needs the Python package open3d; install it with: pip install" in said
    assert "[onboard]'" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("many", "said"), [(11, True), (12, False)])  # the brick has twelve triangles
def test_a_mesh_that_is_simplified_for_long_says_so(
    many: int,
    said: bool,
    mesh: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("huepose.onboarding.batch.MANY_TRIANGLES", many)
    assert main(["onboard", "--no-test", str(mesh), "--name", "brick", "--out", str(tmp_path / "out")]) == 0
    assert ("simplifying 12 triangles, which may take minutes" in capsys.readouterr().err) == said


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


@pytest.mark.parametrize(
    ("inside", "fix"), [("brick.glb", "Did you mean {}?"), ("", "this folder has none.")]
)
def test_a_folder_in_the_place_of_a_mesh_is_said_to_be_one(
    mesh: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], inside: str, fix: str
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    if inside:
        mesh.rename(folder / inside)
    assert main(["onboard", str(folder), "--name", "brick", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert f"{folder}: found a folder; expected a mesh file: .obj, .ply, .glb, .gltf." in said
    assert said.endswith(fix.format(folder / inside) + "\n")


def test_a_folder_without_meshes_ends_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["onboard-bop", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "no obj_NNNNNN.ply or .obj" in capsys.readouterr().err


def bop_scene(path: Path, frames: list[RgbdFrame]) -> None:
    """Frames as a BOP scene's folder."""
    writer = BopWriter(path, {})
    for k, frame in enumerate(frames):
        writer.add(k, frame.color, frame.depth, frame.camera, [])


def recorded(path: Path, frames: list[RgbdFrame], jpeg: bool = False) -> None:
    """Frames as `huepose record` writes them, poses and a frame that came twice between them."""
    out = parts(path, jpeg=jpeg)
    for frame in [frames[0], *frames]:
        color, depth = frame.color, depth_to_wire(frame.depth, 0.0001)
        header = msgspec.structs.replace(
            EXAMPLES[FrameHeader],
            **{"frame_id": frame.frame_id, "capture_ns": frame.stamp_ns, "publish_ns": frame.stamp_ns},
            **{"buffers": pack({"color": color, "depth": depth})[0]},
            intrinsics=intrinsics_to_wire(frame.camera, 0.0001),
        )
        out.frame(header, color, depth, KEY + "frame")
        out.message(KEY + "pose/other/0", EXAMPLES[PoseMessage])
    out.close()


def bag(path: Path, frames: list[RgbdFrame]) -> None:
    """Frames as a bag of ROS."""
    from tests.datasets.test_rosbag import COLOR, DEPTH, INFO, Ros

    ros, at = Ros(path.name), 1_700_000_000_000_000_000
    messages = []
    for k, frame in enumerate(frames):
        now = at + k * 33_000_000
        messages += [
            (INFO, now, ros.info(frame.camera)),
            (COLOR, now, ros.image(frame.color, "rgb8", now)),
            (DEPTH, now, ros.image(frame.depth, "32FC1", now)),
        ]
    ros.write(path, messages)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("turned", bop_scene),
        ("turned.mcap", recorded),
        ("small.mcap", partial(recorded, jpeg=True)),
        ("turned.bag", bag),
    ],
)
def test_a_recording_takes_the_place_of_a_mesh(
    name: str, write: Callable[[Path, list[RgbdFrame]], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("open3d")
    from huepose_services.cli import onboard
    from tests.onboarding.test_from_video import BOX, box_of, drawn, pose

    recording, out = tmp_path / name, tmp_path / "bundles"
    write(recording, [drawn(pose(np.radians(6.0 * k)), k) for k in range(3)])
    jobs = []

    def made(job: object, bundles: Path, settled: bool) -> None:
        assert settled, "nobody gave its unit, so no unit of theirs is doubted"
        jobs.append(job)
        raise KeyboardInterrupt

    monkeypatch.setattr(onboard, "onboard_one", made)
    box = [f"{x:.0f}" for x in box_of(pose(0.0)).box or ()]
    given = ["onboard", "--from-video", str(recording), "--box", *box, "--name", "tea", "--out", str(out)]
    main(given)
    assert [(job.mesh_path, job.unit) for job in jobs] == [(out / "tea_mesh" / "tea.obj", "m")]
    mesh = read_mesh(out / "tea_mesh" / "tea.obj", "m")
    # The sides were not seen over 12 degrees; the height was.
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(np.ptp(BOX.vertices[:, 2]), abs=0.006)


@pytest.mark.parametrize(("surface", "code"), [(0.59, 1), (0.6, 0)])
def test_what_was_seen_of_one_side_alone_tells_a_script(
    surface: float,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from huepose.onboarding.batch import Onboarded
    from huepose_services.cli import onboard, onboard_video
    from tests.onboarding.test_from_video import BOX

    made = SimpleNamespace(
        mesh=BOX, frames=9, T_cam_obj={0: None}, views=1, directions=0.1, surface=surface, closing_m=None
    )
    result = Onboarded("tea", tmp_path / "tea", (0.1, 0.1, 0.1), 0.2, 0, 1, 9, 1.0, False)
    tests = []
    monkeypatch.setattr(onboard_video, "_scene", lambda path: None)
    monkeypatch.setattr(onboard_video, "_learned", lambda *_: made)
    monkeypatch.setattr(onboard, "onboard_one", lambda *_, **__: result)
    monkeypatch.setattr(onboard, "self_test", lambda *given: tests.append(given) or ({}, "tried"))
    given = [
        "onboard",
        "--from-video",
        "t.mcap",
        "--click",
        "1",
        "2",
        "--name",
        "tea",
        "--out",
        str(tmp_path),
    ]
    assert main(given) == code
    assert tests == [(tmp_path, "tea", surface if code else None)]
    assert ("NOT ALL ROUND (exit code 1)" in capsys.readouterr().out) == bool(code)
    assert main([*given, "--json"]) == code
    assert json.loads(capsys.readouterr().out)["video"]["all_round"] == (not code)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "found neither MESH nor --from-video"),
        (["a.obj", "--from-video", "b.mcap"], "found MESH and --from-video"),
        (["--from-video", "b.mcap"], "found neither --box nor --click"),
        (["--from-video", "b.mcap", "--click", "1", "2", "--box", "1", "2", "3", "4"], "found both"),
        (["--from-video", "b.mcap", "--click", "1", "2"], "b.mcap: found No such file"),
        (
            ["--from-video", "b.mcap", "--click", "1", "2", "--unit", "in"],
            "found --unit in; expected no unit",
        ),
    ],
)
def test_what_is_missing_for_a_recording_is_said(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["onboard", *given, "--name", "tea", "--out", str(tmp_path / "bundles")]) == 2
    assert said in capsys.readouterr().err
