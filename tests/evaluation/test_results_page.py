"""The page of results, and the origin of a result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from huepose.datasets.files import read_json
from huepose.evaluation.metrics import auc_voc, four_figures
from huepose.evaluation.result_files import origin, result_names
from huepose.evaluation.results_page import BEGIN, END, results_page, with_cut
from huepose.evaluation.tables.table import Head, Table
from huepose.support.errors import InputError

ROOT = Path(__file__).parents[2]
ORIGIN = {"command": "huepose eval estimate", "date": "2026-01-02", "machine": "m", "versions": "v"}


def test_the_origin_names_the_command_without_folders() -> None:
    facts = origin(
        ["eval", "tables", "--ycbv", "/home/me/data/ycbv", "--boxes=a/b.json", "--note", "two words"]
    )
    assert facts["command"] == "huepose eval tables --ycbv ycbv --boxes=b.json --note 'two words'"
    assert "cores" in facts["machine"]
    assert "numpy " in facts["versions"]


def test_results_with_the_same_name_are_distinguished_by_their_folders() -> None:
    paths = [Path("a/x/results.json"), Path("b/x/results.json"), Path("a/y.json")]
    assert result_names(paths[::2]) == ["x", "y"]
    assert result_names(paths) == ["a-x", "b-x", "a-y"]
    with pytest.raises(InputError, match="same name"):
        result_names([paths[0], paths[0]])


def test_results_of_all_kinds_are_shown_with_their_origin() -> None:
    table = Table("table1", "Table I", (Head("full", "ADD"),), (("Average", (98.76,)),), ("a note",))
    estimate = {
        "origin": ORIGIN,
        "summary": {
            "instances": 27, "recall_add": 100.0, "auc_add": 97.12, "boxes": "paper", "seed": 0, "ar": None,
            "interval95": {"recall_add": [97.0, 100.0]}, "per_object": {5: {"recall_add": 99.0}},
        },
    }  # fmt: skip
    page = results_page(
        {
            "tables": {"origin": ORIGIN, "coverage": ["all is there"], "tables": [table.as_json()]},
            "real": estimate,
        }
    )
    assert page.count("`huepose eval estimate`") == 2
    assert page.count("2026-01-02; m; v.") == 2
    for line in (
        "- all is there", "### Table I", "| Average | 98.8 |", "- a note", "### boxes paper, seed 0",
        "| all | 27 | 100.0 | 97.1 |", "| 95 % of draws |  | 97.0 to 100.0 |  |", "| 5 | - | 99.0 | - |",
    ):  # fmt: skip
        assert line in page.splitlines()


def test_the_interval_of_tracks_is_below_its_figure() -> None:
    """The interval is of the figure over all frames, not of the mean over sequences."""
    summary = {
        "instances": 40, "recall_add": 55.0, "interval95": {"recall_add": [70.0, 80.0]},
        "interval95_over": "half seconds", "frame_weighted": {"instances": 40, "recall_add": 75.0},
    }  # fmt: skip
    lines = results_page({"track": {"origin": ORIGIN, "summary": summary}}).splitlines()
    at = lines.index("| mean over sequences | 40 | 55.0 |")
    assert lines[at + 1 : at + 3] == [
        "| all frames | 40 | 75.0 |",
        "| 95 % of draws of half seconds |  | 70.0 to 80.0 |",
    ]


def test_with_too_few_units_there_is_no_interval() -> None:
    summary = {"instances": 1, "recall_add": 100.0, "interval95": {"recall_add": None}}
    page = results_page({"estimate": {"origin": ORIGIN, "summary": summary}})
    assert "| 95 % of draws |  | - |" in page.splitlines()


def test_the_marked_table_is_an_extract_of_the_first_table_result() -> None:
    heads = (Head("paper, published", "ADD", measured=False), Head("", "n"), Head("full", "ADD"))
    rows = (("002_can", (1.0, 2, 3.0)), ("All labels", (4.0, 5, 66.66)))
    tables = [Table("table1", "Table I", heads, rows).as_json(), Table("other", "O", heads, rows).as_json()]
    before, after = f"# Mine\n\n{BEGIN}\n", f"{END}\n\nThe end.\n"
    whole = with_cut(f"{before}old\n{after}", {"estimate": {}, "tables": {"tables": tables}})
    cut = "| Table I | n | full ADD |\n| --- | --- | --- |\n| YCB-Video | 5 | 66.7 |\n\n"
    assert whole == f"{before}{cut}{after}"
    with pytest.raises(InputError, match="no such lines"):
        with_cut("# Mine", {"tables": {"tables": tables}})
    with pytest.raises(InputError, match="no result"):
        with_cut(whole, {"estimate": {}})


def test_documents_agree_with_the_result_files() -> None:
    """If this fails: `huepose eval results docs/results/*.json --out docs/results.md --readme README.md`."""
    records = {path.stem: read_json(path) for path in sorted((ROOT / "docs" / "results").glob("*.json"))}
    assert records
    assert (ROOT / "docs" / "results.md").read_text() == results_page(records)
    readme = (ROOT / "README.md").read_text()
    assert readme == with_cut(readme, records)


def test_the_page_says_which_area_table_two_has() -> None:
    """VOCap, which is larger than the plain area."""
    errors_m = np.array([0.0, 0.05, 1.0, 1.0, 1.0, 1.0])
    plain = four_figures(errors_m, errors_m, np.full(6, 0.2))["auc_add"]
    assert (plain, auc_voc(errors_m)) == (pytest.approx(25.0), pytest.approx(100.0 / 3.0))
    assert "VOCap, and all of Table II" in " ".join(results_page({}).split())


def test_a_result_without_origin_is_refused() -> None:
    with pytest.raises(InputError, match="no origin"):
        results_page({"old": {"summary": {}}})
