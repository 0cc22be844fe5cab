"""`huepose eval tables` from rendered stand-ins in the official layouts to the report."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.evaluation.pose_files import read_bop_csv
from huepose.evaluation.tables.table import Table
from huepose.scenes.unseen.objects import unseen_objects
from huepose.support.errors import InputError
from huepose_services.cli import evaluate_scenes
from huepose_services.cli.main import main
from huepose_services.cli.table_tracks import TrackSource
from tests.onboarded import few_views
from tests.scenes.stand_ins import stand_in_objects, write_stand_ins
from tests.services.conftest import Says


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """One scene of two images of two objects, one image of which is missing; a sequence of six frames."""
    root = tmp_path_factory.mktemp("data")
    write_stand_ins(root, stand_in_objects(2), images=2, sequences=1, frames=6, seed=0)
    (root / "ycbv" / "test" / "000048" / "rgb" / "000001.png").unlink()
    return root


@pytest.fixture
def onboards_little(onboards_here: None) -> Iterator[None]:
    """Meshes are onboarded in this process, with keypoints from twelve sides."""
    with few_views(templates=False):
        yield


def cells(table: Table, row: str) -> dict[tuple[str, str], object]:
    values = dict(table.rows)[row]
    return {(h.method, h.figure): v for h, v in zip(table.heads, values, strict=True)}


@pytest.mark.timeout(900)
@pytest.mark.usefixtures("onboards_little")
def test_the_whole_command_on_stand_ins(data: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "results"
    command = ["eval", "tables", "--ycbv", str(data / "ycbv"), "--fast-ycb", str(data / "fast")]
    command += ["--out", str(out), "--threads", "1", "--every", "1", "5", "--note", "rendered frames"]
    assert main([*command, "--methods", "full", "paper"]) == 0
    said = capsys.readouterr()
    record = json.loads((out / "results.json").read_text())
    tables = {t["key"]: Table.of_json(t) for t in record["tables"]}
    targets = json.loads((data / "ycbv" / "test_targets_bop19.json").read_text())
    there = sum(t["im_id"] == 0 for t in targets)

    whole = cells(tables["table1"], "All labels")
    assert whole["", "n"] == f"{there} of {len(targets)}"
    assert (whole["full", "ADD"], whole["full", "ADD-S"]) == (100.0, 100.0)
    assert cells(tables["table1"], "003_cracker_box")["Ours (published)", "ADD"] == 73.3
    figures = cells(tables["table1_figures"], "full, all labels")
    assert figures["BOP", "AR"] > 90.0
    assert figures["AUC", "ADD"] > 95.0
    tracks = cells(tables["table2"], "Average")
    assert tracks["full", "AUC ADD"] > 95.0
    assert tracks["", "frames"] == 6
    assert {"full", "full, every 5th", "paper", "paper, every 5th"} <= {
        h.method for h in tables["table2"].heads
    }
    notes = " ".join(record["coverage"])
    assert "1 of 2 images of test_targets_bop19.json are there" in notes
    assert "missing sequences: 003_cracker_box" in notes
    assert "first pose dope" in notes
    assert record["coverage"][0] == "rendered frames"
    assert str(tmp_path) not in record["origin"]["command"]

    poses = read_bop_csv(out / "huepose-full_ycbv-test.csv")
    assert len(poses) == there
    assert (out / "table2.csv").read_text().startswith("method,DOPE,ROFT,")
    page = (out / "report.html").read_text()
    assert page.count("<table>") == 6  # the two of the paper in short, as they are, in all figures
    text = (out / "tables.txt").read_text()
    assert "Table II: tracking" in text
    assert text.rstrip().splitlines()[-1] in said.out

    # A second run measures nothing again; our own poses, read as those of others, give the same figures.
    copy = (out / "huepose-full_ycbv-test.csv").rename(tmp_path / "theirs.csv")
    with copy.open("a") as file:
        file.write("48,0,1,0.1,nan 0 0 0 1 0 0 0 1,0 0 500,-1\n48,0,99,0.1,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")
    before = (out / "runs" / "ycbv-full.jsonl").read_bytes()
    assert main([*command, "--methods", "full", "--submission", f"theirs={copy}"]) == 0
    assert "YCB-Video, full:" not in capsys.readouterr().err
    again = json.loads((out / "results.json").read_text())
    (table,) = (Table.of_json(t) for t in again["tables"] if t["key"] == "table1_figures")
    ours, theirs = cells(table, "full, all labels"), cells(table, "theirs, all labels")
    assert theirs == pytest.approx(ours, abs=1e-6)
    notes = " ".join(again["coverage"])
    assert "theirs: 1 lines have no valid pose" in notes
    assert "theirs: 1 poses are of objects without a reference model" in notes
    assert (out / "runs" / "ycbv-full.jsonl").read_bytes() == before
    assert not (out / "huepose-theirs_ycbv-test.csv").exists()

    # One name for two columns, and results that were measured with other inputs, are refused.
    for names in (["full"], ["theirs", "theirs"]):
        assert main([*command, "--submission", *(f"{name}={copy}" for name in names)]) == 2
        assert "one name for two columns" in capsys.readouterr().err
    equivalent = tmp_path / "equivalent.json"
    equivalent.write_text(json.dumps({"000048/0/0": {"T_obj_obj": [np.eye(4).tolist()]}}))
    assert main([*command, "--methods", "full", "--equivalent", str(equivalent)]) == 2
    assert 'results with the settings {"equivalent": null}' in capsys.readouterr().err
    unlisted = shutil.copytree(data / "ycbv", tmp_path / "ycbv")
    (unlisted / "test_targets_bop19.json").unlink()
    command = ["eval", "tables", "--ycbv", str(unlisted), "--out", str(out), "--threads", "1"]
    assert main([*command, "--methods", "full"]) == 2  # other labels count without the list
    assert 'results with the settings {"min_visib": 0.0}' in capsys.readouterr().err


@pytest.mark.timeout(600)
@pytest.mark.usefixtures("onboards_little")
def test_unseen_objects_are_rendered_onboarded_and_measured(tmp_path: Path, monkeypatch, capsys) -> None:
    """Two of them, in one frame and one sequence."""
    from huepose.scenes import official_sets

    family = {obj.name: obj for obj in unseen_objects()}
    monkeypatch.setattr(official_sets, "unseen_objects", lambda seed: [family["oval_tin"], family["duck"]])
    small = partial(official_sets.write_unseen, scenes=1, frames=1, sequences=1)
    monkeypatch.setattr(official_sets, "write_unseen", small)
    monkeypatch.setattr(official_sets, "SEQUENCE_FRAMES", 7)  # --quick leaves the last one out
    out = tmp_path / "results"
    command = ["eval", "tables", "--unseen", str(tmp_path / "unseen"), "--out", str(out), "--threads", "1"]
    assert main([*command, "--methods", "full", "--quick", "6", "--every", "1"]) == 0
    tables = {t["key"]: Table.of_json(t) for t in json.loads((out / "results.json").read_text())["tables"]}
    assert cells(tables["table1"], "All labels")["", "n"] == 0
    assert cells(tables["table1"], "oval_tin")["full", "ADD-S"] == 100.0
    assert cells(tables["table1"], "Average of unseen, little texture")["", "n"] == 1
    assert cells(tables["table2"], "Average of unseen, textured")["full", "AUC ADD"] > 95.0
    assert "2 by code, 1 with little texture" in capsys.readouterr().out
    assert "Unseen objects" in (out / "report.html").read_text()


def test_a_sequence_that_cannot_be_opened_is_named_and_the_others_stay(
    data: Path, tmp_path: Path, monkeypatch
) -> None:
    (whole,) = (data / "fast").iterdir()
    both = tmp_path / "fast"
    for name in (whole.name, f"{whole.name}_real"):
        shutil.copytree(whole, both / name)
    (both / f"{whole.name}_real" / "gt" / "poses_ycb.txt").write_text("nan 0 0 0 0 1 0\n")
    model = SimpleNamespace(name=whole.name, frame_offset_m=np.zeros(3))
    monkeypatch.setattr(evaluate_scenes, "load_models", lambda *_: {whole.name: model})
    broken: list[str] = []
    scenes, _ = evaluate_scenes.open_fast_ycb([both], tmp_path, broken)
    assert [scene.name for scene in scenes] == [whole.name]
    (reason,) = broken
    assert "poses_ycb.txt, line 1" in reason
    with pytest.raises(InputError, match="line 1"):
        evaluate_scenes.open_fast_ycb([both], tmp_path)
    shutil.rmtree(both / whole.name)
    with pytest.raises(InputError, match="no sequence that can be read"):
        evaluate_scenes.open_fast_ycb([both], tmp_path, [])


def test_only_sequences_of_the_requested_objects_are_opened(data: Path, tmp_path: Path, monkeypatch) -> None:
    (whole,) = (data / "fast").iterdir()
    fast = tmp_path / "fast"
    for name in ("003_cracker_box", "006_mustard_bottle"):
        shutil.copytree(whole, fast / name)
    loaded = []

    def load(folder: Path, names: list[str]) -> dict[str, SimpleNamespace]:
        loaded.append(names)
        return {name: SimpleNamespace(name=name, frame_offset_m=np.zeros(3)) for name in names}

    monkeypatch.setattr(evaluate_scenes, "load_models", load)
    for objects in (("5",), ("006_mustard_bottle", "8")):
        scenes, _ = TrackSource(fast, "fast", (), objects=objects).opened(tmp_path, [])
        assert [scene.name for scene in scenes] == ["006_mustard_bottle"]
    assert loaded == [["006_mustard_bottle"]] * 2  # the others need none
    with pytest.raises(InputError, match="Leave --fast-ycb out"):
        TrackSource(fast, "fast", (), objects=("8",)).opened(tmp_path, [])


def test_missing_data_or_meshes_are_named(data: Path, tmp_path: Path, refused: Says) -> None:
    assert "--ycbv" in refused(["eval", "tables", "--out", tmp_path / "o"])
    assert "--models" in refused(["eval", "tables", "--fast-ycb", data / "fast", "--out", tmp_path / "o"])


@pytest.mark.parametrize("option", ["--quick", "--every"])
def test_a_number_of_frames_under_one_is_refused(option: str, tmp_path: Path, refused: Says) -> None:
    said = refused(["eval", "tables", "--unseen", tmp_path, "--out", tmp_path / "o", option, "0"])
    assert f"argument {option}: found 0, expected a whole number, 1 or more" in said
