"""`huepose eval compare` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from huepose_services.cli.main import main
from tests.evaluation.results import write_estimates, write_track
from tests.services.conftest import Says


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """Before and after: eight of forty instances lost in one set, equal tracks, one unmatched file each."""
    before, after = tmp_path / "before", tmp_path / "after"
    write_estimates(before / "piles.json", {(i, 0): True for i in range(40)})
    write_estimates(after / "piles.json", {(i, 0): i >= 8 for i in range(40)})
    for folder in (before, after):
        write_track(folder / "tracks.json", [True] * 60, ["TRACKING"] * 60, sequences=2)
    write_estimates(before / "heaps.json", {(0, 0): True})
    write_estimates(after / "boxes.json", {(0, 0): True})
    return before, after


def test_a_set_that_became_worse_ends_with_1_and_is_named(folders, tmp_path: Path, capsys) -> None:
    before, after = folders
    result = tmp_path / "result.json"
    assert main(["eval", "compare", str(before), str(after), "--json", str(result)]) == 1
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == "worse: piles (recall ADD -20.0, AUC ADD -8.0)"
    assert f"{before / 'heaps.json'}" in out
    assert f"{after / 'boxes.json'}" in out
    assert "unit: an instance with all its boxes (40)" in out
    assert "lost: scene 000001 image 0 instance 0 object 5;" in out
    record = json.loads(result.read_text())
    assert (record["worse"], [s["set"] for s in record["sets"]]) == (["piles"], ["piles", "tracks"])
    assert len(record["not_compared"]) == 2
    figure = record["sets"][0]["figures"]["recall_add"]
    assert (figure["change"], figure["losses"], figure["verdict"]) == (-20.0, 8, "worse")
    assert record["sets"][0]["lost"][0] == {
        "scene": "000001", "image": 0, "instance": 0, "object": 5, "seed": 0,
    }  # fmt: skip


def test_a_loss_within_its_interval_ends_with_0_and_is_reported(tmp_path: Path, printed: Says) -> None:
    before = write_estimates(tmp_path / "a.json", {(i, 0): True for i in range(40)})
    after = write_estimates(tmp_path / "b.json", {(i, 0): i > 0 for i in range(40)})
    out = printed(["eval", "compare", before, after])
    assert "lost less than the interval allows: a to b (recall ADD -2.5, AUC ADD -1.0)" in out
    assert out.splitlines()[-1] == "worse: none of 1"


def test_a_loss_within_the_margin_ends_with_0(folders) -> None:
    before, after = folders
    assert main(["eval", "compare", str(before), str(after), "--margin", "40"]) == 0


@pytest.mark.parametrize(
    ("after", "extra", "named"),
    [
        ("after/nowhere.json", [], "nowhere.json"),
        ("after", [], "which is not a folder"),
        ("after/piles.json", ["--margin", "-1"], "--margin"),
        ("after/piles.json", ["--margin", "nan"], "--margin"),
        ("after/tracks.json", [], "two of the same kind"),
    ],
)
def test_wrong_usage_ends_with_2_and_is_named(
    folders, tmp_path: Path, refused, after: str, extra: list[str], named: str
) -> None:
    command = ["eval", "compare", str(tmp_path / "before" / "piles.json"), str(tmp_path / after), *extra]
    assert named in refused(command)


def test_folders_without_a_common_name_are_named(tmp_path: Path, refused: Says) -> None:
    for name in ("a", "b"):
        write_estimates(tmp_path / name / f"{name}.json", {(0, 0): True})
    assert "no result file of the same name" in refused(["eval", "compare", tmp_path / "a", tmp_path / "b"])
