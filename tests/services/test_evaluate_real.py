"""`huepose eval` with the real estimator and tracker, on rendered scenes of a printed box."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from huepose.datasets.fast_ycb import FastYcbFrame, write_fast_ycb
from huepose.evaluation.pose_files import read_bop_csv
from huepose.geometry import RgbdFrame, se3
from huepose.model import save_model
from huepose.rendering import render_depth
from huepose_services.cli import pose_tables
from huepose_services.cli.main import main

OFFSET_M = np.array([0.01, -0.02, 0.005])
FRAMES = 8


@pytest.fixture(scope="module")
def bundles(tea_box, tmp_path_factory) -> Path:
    """The tea box with id 5 and a PoseCNN frame of its own."""
    folder = tmp_path_factory.mktemp("bundles")
    save_model(replace(tea_box, object_id=5, frame_offset_m=OFFSET_M), folder / "tea_box.huepose")
    return folder


@pytest.fixture(scope="module")
def shots(tea_box, take_picture, standing) -> list[tuple[RgbdFrame, np.ndarray]]:
    """The box moving 6 mm and 1.5 degrees a frame."""
    taken = []
    for i in range(FRAMES):
        T = se3.perturb(standing, np.array([0.006 * i, 0.0, 0.0, 0.0, 0.026 * i, 0.0]))
        taken.append((take_picture([(tea_box.mesh, T)]), T))
    return taken


@pytest.fixture(scope="module")
def sequence(tea_box, shots, tmp_path_factory) -> Path:
    """The shots as a Fast-YCB sequence; its labels are in the PoseCNN frame."""
    folder = tmp_path_factory.mktemp("fast") / "tea_box_real"
    camera = shots[0][0].camera
    masks = [render_depth(tea_box.mesh, T, camera) > 0 for _, T in shots]
    frames = [FastYcbFrame(s.color, s.depth, mask, T) for (s, T), mask in zip(shots, masks, strict=True)]
    write_fast_ycb(folder, "tea_box", frames, camera, 30.0, OFFSET_M)
    return folder


@pytest.fixture(scope="module")
def scene(shots, tmp_path_factory) -> Path:
    """The first shot as a BOP scene."""
    folder = tmp_path_factory.mktemp("bop") / "000007"
    frame, T = shots[0]
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    cv2.imwrite(str(folder / "rgb" / "000004.png"), frame.color[..., ::-1])
    depth = np.rint(frame.depth * 10000).astype(np.uint16)
    cv2.imwrite(str(folder / "depth" / "000004.png"), depth)
    label = {"obj_id": 5, "cam_R_m2c": T[:3, :3].ravel().tolist(), "cam_t_m2c": (1000 * T[:3, 3]).tolist()}
    camera = {"cam_K": frame.camera.K.ravel().tolist(), "depth_scale": 0.1}
    (folder / "scene_gt.json").write_text(json.dumps({"4": [label, {**label, "obj_id": 16}]}))
    (folder / "scene_camera.json").write_text(json.dumps({"4": camera}))
    return folder


def test_single_frames(bundles: Path, scene: Path, tmp_path: Path, capsys) -> None:
    result, poses, plots = tmp_path / "r.json", tmp_path / "poses.csv", tmp_path / "plots"
    command = ["eval", "estimate", "--bop", str(scene), "--bundles", str(bundles), "--json", str(result)]
    assert main([*command, "--seed", "1", "2", "--csv", str(poses), "--plots", str(plots)]) == 0
    record = json.loads(result.read_text())
    summary = record["summary"]
    assert (summary["instances"], summary["skipped_no_bundle"], summary["recall_add"]) == (1, 1, 100.0)
    assert set(summary["by_seed"]) == {"1", "2"}
    assert [(r["scene"], r["image"], r["object"], r["found"]) for r in record["rows"]] == [
        ("000007", 4, 5, True)
    ] * 2
    assert max(r["add_m"] for r in record["rows"]) < 0.003
    (line,) = read_bop_csv(poses)
    np.testing.assert_allclose(line.T_cam_obj, record["rows"][0]["T_cam_obj"], atol=1e-9)
    assert (plots / "frames" / "000007_000004_s1.png").exists()
    printed = capsys.readouterr().out
    assert "1 labels without reference model skipped" in printed
    assert "95 % intervals over frames: -, -, -, -\n" in printed, "one frame is too few"


def test_tracking_alone_and_with_late_results(bundles: Path, sequence: Path, tmp_path: Path, capsys) -> None:
    for protocol in (["--init", "gt"], ["--protocol", "roft", "--every", "2"]):
        result = tmp_path / "r.json"
        command = f"eval track --fast-ycb {sequence} --bundles {bundles} --json {result}".split()
        assert main([*command, *protocol]) == 0
        assert "95 % intervals of all frames, over half seconds: " in capsys.readouterr().out
        record = json.loads(result.read_text())
        assert record["summary"]["recall_add"] == 100.0
        assert record["summary"]["sequences"]["tea_box_real"]["auc_add"] > 95.0
        assert {r["object"] for r in record["rows"]} == {5}


def test_poses_of_a_file_start_the_tracker_in_either_frame(
    bundles: Path, sequence: Path, shots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    T = shots[0][1]
    R, t = se3.rotation_exp([0.5, -1.0, 0.2]), np.array([0.01, 0.0, -0.03])
    monkeypatch.setattr(pose_tables, "ycb_named", lambda name: SimpleNamespace(T_nvdu_posecnn=se3.make(R, t)))
    T_cam_nvdu = T @ se3.make(np.eye(3), OFFSET_M) @ se3.inverse(se3.make(R, t))
    w = se3.rotation_log(T_cam_nvdu[:3, :3])
    dope, table = tmp_path / "poses.txt", tmp_path / "tea_box_real.csv"
    row = (*T_cam_nvdu[:3, 3], *(w / np.linalg.norm(w)), np.linalg.norm(w))
    dope.write_text(" ".join(f"{v:.9f}" for v in row))
    q = se3.quaternion_from_rotation(T[:3, :3])
    table.write_text("0,tea_box," + ",".join(f"{v:.9f}" for v in (*T[:3, 3], *q)))
    T_cam_posecnn = T @ se3.make(np.eye(3), OFFSET_M)
    w = se3.rotation_log(T_cam_posecnn[:3, :3])
    posecnn = tmp_path / "poses_ycb.txt"
    row = (*T_cam_posecnn[:3, 3], *(w / np.linalg.norm(w)), np.linalg.norm(w))
    posecnn.write_text(" ".join(f"{v:.9f}" for v in row))
    ways = [["--init", str(tmp_path)], ["--init", str(dope)], ["--init", str(posecnn)]]
    command = ["eval", "track", "--fast-ycb", str(sequence), "--bundles", str(bundles)]
    for way in ways:
        assert main([*command, *way, "--json", str(tmp_path / "r.json")]) == 0
        rows = json.loads((tmp_path / "r.json").read_text())["rows"]
        assert max(r["add_m"] for r in rows) < 0.004


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        (["--init", "nowhere.csv"], "nowhere.csv"),
        (["--delayed", "gt"], "--delayed"),
        (["--init", "gt", "--every", "0"], "--every"),
    ],
)
def test_wrong_usage_is_named(
    bundles: Path, sequence: Path, tmp_path: Path, refused, extra: list[str], named: str
) -> None:
    command = ["eval", "track", "--fast-ycb", str(sequence), "--bundles", str(bundles)]
    assert named in refused([*command, *extra, "--json", tmp_path / "r.json"])


@pytest.mark.parametrize(
    ("option", "value"),
    [("--rotation", "kabsch"), ("--rotation-model", "turn.onnx"), ("--flow", "neuflow.onnx")],
)
def test_options_of_the_papers_tracker_are_refused_with_another_method(
    tmp_path: Path, capsys, refused, option: str, value: str
) -> None:
    command = f"eval track --fast-ycb nowhere --bundles nowhere --json {tmp_path / 'r'} {option} {value}"
    assert main(command.split()) == 2
    said = f"huepose eval: {option}: found it with --method full; expected --method paper.\n"
    assert capsys.readouterr().err == said
    assert option not in refused([*command.split(), "--method", "paper"])


def test_a_rotation_network_is_refused_with_the_closed_form(tmp_path: Path, capsys) -> None:
    command = f"eval track --fast-ycb nowhere --bundles nowhere --json {tmp_path / 'r'} --method paper"
    assert main([*command.split(), "--rotation", "kabsch", "--rotation-model", "turn.onnx"]) == 2
    assert "huepose eval: --rotation-model: found it with --rotation kabsch" in capsys.readouterr().err


def test_a_sequence_without_reference_model_is_named(
    bundles: Path, sequence: Path, tmp_path: Path, refused
) -> None:
    renamed = tmp_path / "mug_real"
    renamed.symlink_to(sequence)
    command = f"eval track --fast-ycb {renamed} --bundles {bundles} --json {tmp_path / 'r'}".split()
    assert "tea_box" in refused(command)
